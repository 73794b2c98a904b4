// Torque and, where there is one, angle over time. The plots of one log show the same stretch of time.
(() => {
  const { color } = plots;
  const { logs } = plots.data;
  const prior = document.getElementById("prior");

  const line = (x, joint, name, yaxis, style) => ({
    x, y: joint[name], name, yaxis, type: "scatter", mode: "lines", hoverinfo: "x+y+name", line: style,
  });

  function traces(log, joint) {
    const drawn = [
      line(log.t, joint, "measured", "y", { color: color("measured"), width: 4 }),
      line(log.t, joint, "predicted", "y", { color: color("predicted"), width: 1.3 }),
      line(log.t, joint, "residual", "y2", { color: color("residual"), width: 1 }),
    ];
    if (prior && prior.checked) drawn.push(line(log.t, joint, "prior", "y", { color: color("prior"), width: 1.3, dash: "dot" }));
    if (joint.position) drawn.push(line(log.t, joint, "position", "y3", { color: color("ink"), width: 1.3 }));
    return drawn;
  }

  function layout(log, joint) {
    const axis = plots.axis();
    const start = log.start ? ` − ${log.start}` : "";
    const [torque, residual, position] = joint.position ? [[0.3, 0.64], [0, 0.24], [0.7, 1]] : [[0.36, 1], [0, 0.28]];
    const angle = joint.unit === "N" ? "position [m]" : "angle [rad]";
    return {
      ...plots.layout(joint.position ? 460 : 340), hovermode: "x",
      xaxis: { ...axis, anchor: "y2", title: { text: `t${start} [s]` }, ...(log.range ? { range: log.range } : {}) },
      yaxis: { ...axis, domain: torque, title: { text: `torque [${joint.unit}]` } },
      yaxis2: { ...axis, domain: residual, title: { text: "residual" }, nticks: 6 },
      ...(position ? { yaxis3: { ...axis, domain: position, title: { text: angle } } } : {}),
    };
  }

  function draw(plot) {
    const log = logs[plot.dataset.log];
    const joint = log.joints[plot.dataset.joint];
    Plotly.react(plot, traces(log, joint), layout(log, joint), plots.config());
    plots.together(plot, log);
  }

  plots.watch(document.querySelectorAll("[data-log]"), draw);
  if (prior) prior.addEventListener("change", plots.redraw);
})();
