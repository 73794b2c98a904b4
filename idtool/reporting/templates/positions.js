// Measured and simulated position over time. The plots of one log show the same stretch of time.
(() => {
  const { color } = plots;
  if (!plots.data.simulation) return;
  const { logs } = plots.data.simulation;
  const prior = document.getElementById("simulated-prior");

  const line = (x, y, name, style) => ({ x, y, name, type: "scatter", mode: "lines", hoverinfo: "x+y+name", line: style });

  function traces(log, joint) {
    const drawn = [line(log.t, joint.measured, "measured", { color: color("measured"), width: 4 })];
    if (joint.simulated) drawn.push(line(log.t, joint.simulated, "simulated", { color: color("predicted"), width: 1.3 }));
    if (joint.prior && prior.checked) drawn.push(line(log.t, joint.prior, "prior", { color: color("prior"), width: 1.3, dash: "dot" }));
    return drawn;
  }

  function layout(log, joint) {
    const axis = plots.axis();
    const start = log.start ? ` − ${log.start}` : "";
    return {
      ...plots.layout(240), hovermode: "x",
      xaxis: { ...axis, title: { text: `t${start} [s]` }, ...(log.range ? { range: log.range } : {}) },
      yaxis: { ...axis, title: { text: joint.unit === "m" ? "position [m]" : "angle [rad]" }, range: [...joint.range] },
    };
  }

  function draw(plot) {
    const log = logs[plot.dataset.simulated];
    const joint = log.joints[plot.dataset.joint];
    Plotly.react(plot, traces(log, joint), layout(log, joint), plots.config());
    plots.together(plot, log);
  }

  plots.watch(document.querySelectorAll("[data-simulated]"), draw);
  if (prior) prior.addEventListener("change", plots.redraw);
})();
