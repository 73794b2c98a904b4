// Charts of curves over one x axis.
(() => {
  const { color } = plots;
  const gap = 0.07; // between panels, of the height

  // A colour of the style sheet, #rrggbb, let through so far.
  const tint = (name, alpha) => {
    const [r, g, b] = [1, 3, 5].map((at) => parseInt(color(name).slice(at, at + 2), 16));
    return `rgba(${r}, ${g}, ${b}, ${alpha})`;
  };

  function curve(line, x, yaxis, log) {
    const positive = (y) => (log ? y.map((v) => (v > 0 ? v : null)) : y);
    const common = { x, yaxis, type: "scatter", mode: "lines" };
    const edge = { ...common, line: { width: 0 }, hoverinfo: "skip" };
    const band = line.lower ? [
      { ...edge, y: positive(line.lower) },
      { ...edge, y: positive(line.upper), fill: "tonexty", fillcolor: tint(line.color, 0.18) },
    ] : [];
    const width = { color: color(line.color), width: 2, dash: line.dash };
    return [...band, {
      ...common, name: line.name, y: positive(line.y), line: width, hoverinfo: "x+y+name",
      mode: x.length > 40 ? "lines" : "lines+markers", marker: { size: 5 }, hoverlabel: { namelength: -1 },
    }];
  }

  const yaxis = (i) => (i ? `y${i + 1}` : "y");

  function layout(chart) {
    const axis = plots.axis();
    const { panels } = chart;
    const height = (1 - gap * (panels.length - 1)) / panels.length;
    const drawn = {
      ...plots.layout(panels.length > 1 ? 460 : 340), hovermode: "closest", shapes: [],
      xaxis: { ...axis, anchor: yaxis(panels.length - 1), title: { text: chart.x.title }, type: chart.x.log ? "log" : "linear" },
    };
    panels.forEach((panel, i) => {
      const top = 1 - i * (height + gap);
      drawn[`yaxis${i ? i + 1 : ""}`] = {
        ...axis, domain: [Math.max(top - height, 0), top], title: { text: panel.title },
        ...(panel.log ? { type: "log", exponentformat: "power" } : {}),
      };
      if (panel.level !== null) drawn.shapes.push({
        type: "line", xref: "paper", x0: 0, x1: 1, yref: yaxis(i), y0: panel.level, y1: panel.level,
        line: { color: color("quiet"), width: 1, dash: "dot" },
      });
    });
    return drawn;
  }

  function draw(plot) {
    const chart = plots.data.charts[plot.dataset.chart];
    const curves = chart.panels.flatMap((panel, i) =>
      panel.lines.flatMap((line) => curve(line, chart.x.values, yaxis(i), panel.log)));
    Plotly.react(plot, curves, layout(chart), plots.config());
  }

  plots.watch(document.querySelectorAll("[data-chart]"), draw);
})();
