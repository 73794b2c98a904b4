// The gap closing step by step.
(() => {
  const { color } = plots;
  const { gap } = plots.data;

  const line = (x, y, name, shade, extra) => ({
    x, y, name, type: "scatter", mode: "lines+markers", hoverinfo: "x+y+name", hoverlabel: { namelength: -1 },
    line: { color: color(shade), width: 2 }, marker: { size: 7 }, ...extra,
  });

  function drawGap(plot) {
    const { torque, rollout } = gap.joints[plot.dataset.gap];
    const at = gap.names.map((_, i) => i);
    const told = { text: gap.names, hoverinfo: "y+text" };
    const axis = { ...plots.axis(), rangemode: "tozero" };
    const drawn = [line(at, torque.values, "torque", "c5", told)];
    if (rollout) drawn.push(line(at, rollout.values, "rollout", "c2", { ...told, yaxis: "y2" }));
    const ticks = gap.names.map((name, i) => (i && name.includes(":") ? name.slice(0, name.indexOf(":")) : i ? "end" : "given"));
    const layout = {
      ...plots.layout(plot.clientHeight || 240), hovermode: "closest",
      xaxis: {
        ...plots.axis(), anchor: rollout ? "y2" : "y", title: { text: "step" }, range: [-0.3, at.length - 0.7],
        tickvals: at, ticktext: ticks, zeroline: false,
      },
      yaxis: { ...axis, domain: rollout ? [0.55, 1] : [0, 1], title: { text: `torque [${torque.unit.replace(" together", "")}]` } },
      ...(rollout ? { yaxis2: { ...axis, domain: [0, 0.45], title: { text: `rollout [${rollout.unit.replace(" together", "")}]` } } } : {}),
      shapes: torque.floor === null ? [] : [{
        type: "line", xref: "paper", x0: 0, x1: 1, yref: "y", y0: torque.floor, y1: torque.floor,
        line: { color: color("quiet"), width: 2, dash: "dot" },
      }],
    };
    Plotly.react(plot, drawn, layout, plots.config());
  }

  plots.watch(document.querySelectorAll("[data-gap]"), drawGap);
})();
