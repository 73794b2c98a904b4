"use strict";
// Draws a plot when it comes near the screen. The plots of one log show the same stretch of time.
(() => {
  const { logs } = JSON.parse(document.getElementById("curves").textContent);
  const plots = [...document.querySelectorAll(".plot")];
  const prior = document.getElementById("prior");
  const root = document.documentElement;
  const touch = matchMedia("(pointer: coarse)").matches; // there, a finger on a plot scrolls the page
  const printed = 680; // px

  const line = (x, joint, name, yaxis, style) => ({
    x, y: joint[name], name, yaxis, type: "scatter", mode: "lines", hoverinfo: "x+y+name", line: style,
  });

  function traces(log, joint, color) {
    const drawn = [
      line(log.t, joint, "measured", "y", { color: color("measured"), width: 4 }),
      line(log.t, joint, "predicted", "y", { color: color("predicted"), width: 1.3 }),
      line(log.t, joint, "residual", "y2", { color: color("residual"), width: 1 }),
    ];
    if (prior && prior.checked) drawn.push(line(log.t, joint, "prior", "y", { color: color("prior"), width: 1.3, dash: "dot" }));
    return drawn;
  }

  function layout(log, joint, color, range) {
    const axis = { gridcolor: color("line"), zerolinecolor: color("line"), linecolor: color("line") };
    const start = log.start ? ` − ${log.start}` : "";
    return {
      width: root.classList.contains("paper") ? printed : undefined, height: 340,
      margin: { l: 60, r: 8, t: touch ? 28 : 8, b: 40 }, showlegend: false, hovermode: "x", dragmode: touch ? false : "zoom",
      paper_bgcolor: color("page"), plot_bgcolor: color("page"),
      font: { color: color("ink"), size: 12, family: "system-ui, sans-serif" }, uirevision: "zoom",
      xaxis: { ...axis, anchor: "y2", title: { text: `t${start} [s]` }, ...(range ? { range } : {}) },
      yaxis: { ...axis, domain: [0.36, 1], title: { text: `torque [${joint.unit}]` } },
      yaxis2: { ...axis, domain: [0, 0.28], title: { text: "residual" }, nticks: 6 },
    };
  }

  // The buttons are listed one by one because plotly.js by itself adds one that uploads the data.
  const config = {
    displaylogo: false, responsive: true, showSendToCloud: false, plotlyServerURL: "",
    modeBarButtons: [["zoom2d", "pan2d", "resetScale2d", "toImage"]],
  };

  function draw(plot) {
    const log = logs[plot.dataset.log];
    const joint = log.joints[plot.dataset.joint];
    const style = getComputedStyle(root);
    const color = (name) => style.getPropertyValue(`--${name}`).trim();
    Plotly.react(plot, traces(log, joint, color), layout(log, joint, color, log.range), config);
    if (!plot.dataset.drawn) plot.on("plotly_relayout", (change) => follow(plot, change));
    plot.dataset.drawn = "yes";
  }

  const drawn = () => plots.filter((plot) => plot.dataset.drawn);
  let following = false;

  function follow(plot, change) {
    const whole = change["xaxis.autorange"];
    if (following || !(whole || "xaxis.range[0]" in change)) return;
    const log = logs[plot.dataset.log];
    log.range = whole ? undefined : [change["xaxis.range[0]"], change["xaxis.range[1]"]];
    const others = drawn().filter((other) => other !== plot && other.dataset.log === plot.dataset.log);
    following = true;
    const same = () => (whole ? { "xaxis.autorange": true } : { "xaxis.range": [...log.range] });
    Promise.all(others.map((other) => Plotly.relayout(other, same()))).finally(() => { following = false; });
  }

  const watch = new IntersectionObserver(
    (entries) => entries.filter((entry) => entry.isIntersecting).forEach(({ target }) => {
      watch.unobserve(target);
      draw(target);
    }),
    { rootMargin: "400px" },
  );
  plots.forEach((plot) => watch.observe(plot));

  const redraw = () => drawn().forEach(draw);
  if (prior) prior.addEventListener("change", redraw);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
  addEventListener("beforeprint", () => {
    root.classList.add("paper");
    plots.filter((plot) => plot.closest("details").open).forEach(draw);
  });
  addEventListener("afterprint", () => {
    root.classList.remove("paper");
    redraw();
    drawn().forEach(Plotly.Plots.resize);
  });
})();
