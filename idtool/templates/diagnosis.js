// The gap closing step by step, and what the model leaves of the torque before and after, by state and frequency.
(() => {
  const { color } = plots;
  const { gap, residuals } = plots.data;
  const shades = { before: "c1", after: "c5" };

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

  function drawResidual(plot) {
    const view = residuals[plot.dataset.residual].views[plot.dataset.view];
    const positive = (y) => (view.log ? y.map((v) => (v > 0 ? v : null)) : y);
    const drawn = Object.entries(shades).flatMap(([model, shade]) => {
      const { at, mean, rms } = view[model];
      const style = (dash) => ({ mode: "lines", line: { color: color(shade), width: 1.6, dash } });
      return [
        ...(mean ? [line(at, mean, `mean ${model}`, shade, style("solid"))] : []),
        line(at, positive(rms), mean ? `RMS ${model}` : model, shade, style(mean ? "dot" : "solid")),
      ];
    });
    const axis = plots.axis();
    const layout = {
      ...plots.layout(240), hovermode: "closest",
      xaxis: { ...axis, title: { text: view.x } },
      yaxis: { ...axis, title: { text: view.y }, ...(view.log ? { type: "log", exponentformat: "power" } : { rangemode: "tozero" }) },
    };
    Plotly.react(plot, drawn, layout, plots.config(["resetScale2d", "toImage"]));
  }

  plots.watch(document.querySelectorAll("[data-gap]"), drawGap);
  plots.watch(document.querySelectorAll("[data-residual]"), drawResidual);
})();
