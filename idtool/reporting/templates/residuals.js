// What two models leave of the torque, by state and frequency.
(() => {
  const { color } = plots;
  const { residuals } = plots.data;
  if (!residuals) return;
  const shades = { before: "c1", after: "c5" };

  const line = (x, y, name, shade, extra) => ({
    x, y, name, type: "scatter", mode: "lines+markers", hoverinfo: "x+y+name", hoverlabel: { namelength: -1 },
    line: { color: color(shade), width: 2 }, marker: { size: 7 }, ...extra,
  });

  function drawResidual(plot) {
    const view = residuals.joints[plot.dataset.residual].views[plot.dataset.view];
    const positive = (y) => (view.log ? y.map((v) => (v > 0 ? v : null)) : y);
    const drawn = Object.entries(shades).flatMap(([model, shade]) => {
      const title = residuals.names[model];
      const { at, mean, rms } = view[model];
      const style = (dash) => ({ mode: "lines", line: { color: color(shade), width: 1.6, dash } });
      return [
        ...(mean ? [line(at, mean, `mean ${title}`, shade, style("solid"))] : []),
        line(at, positive(rms), mean ? `RMS ${title}` : title, shade, style(mean ? "dot" : "solid")),
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

  plots.watch(document.querySelectorAll("[data-residual]"), drawResidual);
})();
