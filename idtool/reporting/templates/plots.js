// What all plots share. A plot is drawn when it comes near the screen, and again when the page's colours change.
const plots = (() => {
  const root = document.documentElement;
  const style = getComputedStyle(root);
  const touch = matchMedia("(pointer: coarse)").matches; // there, a finger on a plot scrolls the page
  const printed = 680; // px
  const watched = new Map();

  const color = (name) => style.getPropertyValue(`--${name}`).trim();
  const paper = () => root.classList.contains("paper");
  const axis = () => ({ gridcolor: color("line"), zerolinecolor: color("line"), linecolor: color("line") });
  const layout = (height) => ({
    width: paper() ? printed : undefined, height, showlegend: false,
    margin: { l: 60, r: 8, t: 32, b: 40 }, dragmode: touch ? false : "zoom",
    paper_bgcolor: color("page"), plot_bgcolor: color("page"),
    font: { color: color("ink"), size: 12, family: "system-ui, sans-serif" }, uirevision: "zoom",
  });

  // The buttons are listed one by one because plotly.js by itself adds one that uploads the data.
  const config = (buttons = ["zoom2d", "pan2d", "resetScale2d", "toImage"]) => ({
    displaylogo: false, responsive: true, showSendToCloud: false, plotlyServerURL: "", modeBarButtons: [buttons],
  });

  function draw(plot) {
    watched.get(plot)(plot);
    plot.dataset.drawn = "yes";
  }

  function erase(plot) {
    Plotly.purge(plot);
    delete plot.dataset.drawn;
  }

  const near = new IntersectionObserver(
    (entries) => entries.filter((entry) => entry.isIntersecting).forEach(({ target }) => {
      near.unobserve(target);
      draw(target);
    }),
    { rootMargin: "400px" },
  );

  // Have each plot drawn, by a function of the plot, once it comes near the screen.
  function watch(elements, by) {
    elements.forEach((plot) => {
      watched.set(plot, by);
      near.observe(plot);
    });
  }

  const all = () => [...watched.keys()];
  const drawn = () => all().filter((plot) => plot.dataset.drawn);
  const redraw = () => drawn().forEach(draw);
  const hidden = (plot) => plot.closest("details:not([open])");

  // Have the plots of one log show the same stretch of time, which the log remembers as its range.
  const shows = new Map();
  let following = false;

  function together(plot, log) {
    shows.set(plot, log);
    if (!plot.dataset.drawn) plot.on("plotly_relayout", (change) => follow(plot, change));
  }

  function follow(plot, change) {
    const whole = change["xaxis.autorange"];
    if (following || !(whole || "xaxis.range[0]" in change)) return;
    const log = shows.get(plot);
    log.range = whole ? undefined : [change["xaxis.range[0]"], change["xaxis.range[1]"]];
    const others = drawn().filter((other) => other !== plot && shows.get(other) === log);
    following = true;
    const same = () => (whole ? { "xaxis.autorange": true } : { "xaxis.range": [...log.range] });
    Promise.all(others.map((other) => Plotly.relayout(other, same()))).finally(() => { following = false; });
  }

  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
  addEventListener("beforeprint", () => {
    root.classList.add("paper");
    all().filter((plot) => !hidden(plot)).forEach(draw);
  });
  addEventListener("afterprint", () => {
    root.classList.remove("paper");
    redraw();
    drawn().forEach(Plotly.Plots.resize);
  });

  const data = JSON.parse(document.getElementById("data").textContent);
  return { data, touch, color, axis, layout, config, watch, together, draw, drawn, redraw, erase };
})();
