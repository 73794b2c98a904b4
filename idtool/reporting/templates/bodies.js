// One body at a time in its frame, in 3D.
(() => {
  const { color } = plots;
  const { solid, markers, layout, show } = solids;

  function traces({ bounds, found, prior, masses }) {
    const drawn = bounds.flatMap((shape) => solid(shape, `bound: ${shape.kind}`, color("measured"), 0.15, "solid"));
    const spread = (body, name, shade, opacity, dash) => {
      if (!body) return;
      drawn.push(...solid({ kind: "ellipsoid", ...body }, name, shade, opacity, dash));
      drawn.push(markers([body.center], name, [`centre of mass: ${name}`], { color: shade, symbol: "diamond", size: 5 }));
    };
    spread(prior, "prior", color("prior"), 0, "dash");
    spread(found, "identified", color("predicted"), 0.35, "solid");
    if (masses) {
      const most = Math.max(...masses.masses);
      const size = masses.masses.map((m) => 4 + 12 * Math.sqrt(m / most));
      const text = masses.masses.map((m) => `${m} kg`);
      drawn.push(markers(masses.points, "point masses", text, { color: color("residual"), size, line: { width: 0 } }));
    }
    return drawn;
  }

  function draw(plot) {
    if (!plot.closest("details").open) return;
    const drawn = traces(plots.data.bodies[plot.dataset.body]);
    show(plot, drawn, layout(drawn));
  }

  const bodies = [...document.querySelectorAll("details.body")];
  const plotOf = (body) => body.querySelector(".plot");
  plots.watch(bodies.map(plotOf), draw);
  bodies.forEach((body) => body.addEventListener("toggle", () => {
    if (!body.open) return plots.erase(plotOf(body));
    bodies.filter((other) => other !== body).forEach((other) => { other.open = false; });
    plots.draw(plotOf(body));
  }));
  solids.copied(() => bodies.filter((body) => body.open).map(plotOf));
})();
