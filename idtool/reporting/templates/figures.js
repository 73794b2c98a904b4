// Figures made in Python. Colours are names of the style sheet, with an opacity behind them where they have one; x, y and
// text of a trace are numbers of arrays of the page.
(() => {
  const { figures, arrays } = plots.data;
  const logs = new Map(); // the range of time that the plots of a log show, by its fold

  function shade(given) {
    const [name, opacity] = given.split(" ");
    const rgb = plots.color(name);
    return opacity ? `rgba(${[1, 3, 5].map((at) => parseInt(rgb.slice(at, at + 2), 16))}, ${opacity})` : rgb;
  }

  function colored(part) {
    if (Array.isArray(part)) return part.map(colored);
    if (part === null || typeof part !== "object") return part;
    return Object.fromEntries(Object.entries(part).map(([key, value]) =>
      [key, key.endsWith("color") ? shade(value) : colored(value)]));
  }

  // Curves that are "legendonly" are drawn where their box in the section is ticked.
  function ticked(plot) {
    const boxes = [...plot.closest("section").querySelectorAll("[data-curve]")];
    return new Set(boxes.filter((box) => box.checked).map((box) => box.dataset.curve));
  }

  function traces(plot, data) {
    const shown = ticked(plot);
    const stored = (trace) => ["x", "y", "text"].filter((key) => key in trace).map((key) => [key, arrays[trace[key]]]);
    return colored(data).map((trace) => ({
      ...trace, ...Object.fromEntries(stored(trace)), visible: trace.visible !== "legendonly" || shown.has(trace.name),
    }));
  }

  function layout(given, log) {
    const themed = { ...plots.layout(given.height), ...colored(given) };
    Object.keys(given).filter((name) => /^[xy]axis\d*$/.test(name)).forEach((name) => {
      themed[name] = { ...plots.axis(), ...themed[name] };
    });
    if (log && log.range) themed.xaxis.range = [...log.range];
    return themed;
  }

  function draw(plot) {
    const figure = figures[plot.dataset.figure];
    const log = logs.get(plot.closest("details.log"));
    const { buttons } = plot.dataset;
    Plotly.react(plot, traces(plot, figure.data), layout(figure.layout, log), plots.config(buttons && buttons.split(" ")));
    if (log) plots.together(plot, log);
  }

  document.querySelectorAll("details.log").forEach((fold) => logs.set(fold, {}));
  document.querySelectorAll("[data-curve]").forEach((box) => box.addEventListener("change", plots.redraw));
  plots.watch(document.querySelectorAll("[data-figure]"), draw);
})();
