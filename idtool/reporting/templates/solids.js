// Solids in 3D, and views of them: what the plots of one body and of the whole robot share.
const solids = (() => {
  const { color } = plots;
  const around = 32; // sides of what is round

  // Turn points by roll, pitch, yaw and move them.
  function place(points, { center, rpy = [0, 0, 0] }) {
    const [[cr, sr], [cp, sp], [cy, sy]] = rpy.map((angle) => [Math.cos(angle), Math.sin(angle)]);
    const R = [
      [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
      [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
      [-sp, cp * sr, cp * cr],
    ];
    return points.map((x) => R.map((row, k) => row[0] * x[0] + row[1] * x[1] + row[2] * x[2] + center[k]));
  }

  // A profile [[r, z], …] turned about the z axis, as rings of points; in units of scale along x, y and z.
  const lathe = (profile, scale, sides = around, start = 0) => profile.map(([r, z]) =>
    [...Array(sides)].map((_, k) => {
      const angle = start + (2 * Math.PI * k) / sides;
      return [scale[0] * r * Math.cos(angle), scale[1] * r * Math.sin(angle), scale[2] * z];
    }));

  const arc = (from, to, count) => [...Array(count + 1)].map((_, k) => from + ((to - from) * k) / count);

  // Rings of points of each kind of solid; its outline: rings at these levels, and lines along it between two of them.
  const kinds = {
    ellipsoid: ({ semi_axes }) => ({
      rings: lathe(arc(-Math.PI / 2, Math.PI / 2, 16).map((a) => [Math.cos(a), Math.sin(a)]), semi_axes), levels: [8], along: [0, 17],
    }),
    box: ({ size }) => ({
      rings: lathe([[0, -1], [1, -1], [1, 1], [0, 1]], [...size.slice(0, 2).map((x) => x / Math.SQRT2), size[2] / 2], 4, Math.PI / 4),
      levels: [1, 2], along: [1, 3],
    }),
    cylinder: ({ radius, length }) => ({
      rings: lathe([[0, -1], [1, -1], [1, 1], [0, 1]], [radius, radius, length / 2]), levels: [1, 2], along: [1, 3],
    }),
    capsule: ({ radius, length }) => {
      const cap = (from, to, z) => arc(from, to, 8).map((a) => [radius * Math.cos(a), radius * Math.sin(a) + z]);
      const profile = [...cap(-Math.PI / 2, 0, -length / 2), ...cap(0, Math.PI / 2, length / 2)];
      return { rings: lathe(profile, [1, 1, 1]), levels: [8, 9], along: [0, 18] };
    },
  };

  const columns = (points) => Object.fromEntries(["x", "y", "z"].map((name, k) => [name, points.map((x) => x && x[k])]));

  function surface(points, faces, name, shade, opacity) {
    return {
      ...columns(points), ...faces, type: "mesh3d", name, color: shade, opacity, hoverinfo: "name", flatshading: false,
      lighting: { ambient: 0.7, diffuse: 0.5, specular: 0.1 },
    };
  }

  // A solid as a translucent surface, unless opacity is 0, and its outline.
  function solid(shape, name, shade, opacity, dash) {
    if (shape.kind === "hull") return [surface(shape.vertices, { alphahull: 0 }, name, shade, opacity)];
    const { rings, levels, along } = kinds[shape.kind](shape);
    const sides = rings[0].length;
    const faces = { i: [], j: [], k: [] };
    const face = (...corners) => ["i", "j", "k"].forEach((name, at) => faces[name].push(corners[at]));
    for (let r = 0; r + 1 < rings.length; r += 1) {
      for (let s = 0; s < sides; s += 1) {
        const [a, b] = [r * sides + s, r * sides + ((s + 1) % sides)];
        face(a, b, a + sides);
        face(b, b + sides, a + sides);
      }
    }
    const outline = [
      ...levels.map((r) => [...rings[r], rings[r][0]]),
      ...[0, 1, 2, 3].map((k) => rings.slice(...along).map((ring) => ring[(k * sides) / 4])),
    ].flatMap((path) => [...place(path, shape), null]);
    const drawn = {
      ...columns(outline), type: "scatter3d", mode: "lines", name, hoverinfo: "name", line: { color: shade, width: 3, dash },
    };
    return [...(opacity ? [surface(place(rings.flat(), shape), faces, name, shade, opacity)] : []), drawn];
  }

  const markers = (points, name, text, marker) => ({
    ...columns(points), type: "scatter3d", mode: "markers", name, text, hoverinfo: "text", marker,
  });

  // Equal scales on the three axes, and all in view.
  function box(drawn) {
    const middle = {}, extent = {};
    for (const name of ["x", "y", "z"]) {
      let [least, most] = [Infinity, -Infinity];
      drawn.forEach((trace) => trace[name].filter(Number.isFinite).forEach((x) => { [least, most] = [Math.min(least, x), Math.max(most, x)]; }));
      middle[name] = (least + most) / 2;
      extent[name] = 1.1 * (most - least);
    }
    const least = 0.2 * Math.max(...Object.values(extent)) || 1;
    const size = (name) => Math.max(extent[name], least);
    const diagonal = Math.hypot(size("x"), size("y"), size("z"));
    return (name) => ({
      range: [middle[name] - size(name) / 2, middle[name] + size(name) / 2], ratio: (1.7 * size(name)) / diagonal,
    });
  }

  function layout(drawn, height = 420) {
    const place = box(drawn);
    const axis = (name) => ({
      ...plots.axis(), title: { text: `${name} [m]` }, color: color("quiet"), showbackground: false, showspikes: false, nticks: 6,
      range: place(name).range,
    });
    return {
      ...plots.layout(height), margin: { l: 0, r: 0, t: 0, b: 0 }, dragmode: undefined,
      scene: {
        aspectmode: "manual", aspectratio: { x: place("x").ratio, y: place("y").ratio, z: place("z").ratio }, dragmode: "turntable", bgcolor: color("page"), uirevision: "view",
        xaxis: axis("x"), yaxis: axis("y"), zaxis: axis("z"),
      },
    };
  }

  const buttons = ["orbitRotation", "pan3d", "zoom3d", "resetCameraDefault3d", "toImage"];
  const show = (plot, drawn, view) => Plotly.react(plot, drawn, view, { ...plots.config(buttons), scrollZoom: false });

  // What WebGL draws is gone by the time a page is printed; there, a copy stands in for it.
  const copied = (found) => addEventListener("beforeprint", () => found().forEach((plot) => {
    const glplot = plot._fullLayout?.scene?._scene?.glplot;
    if (!glplot) return;
    const copy = Object.assign(document.createElement("canvas"), { width: glplot.canvas.width, height: glplot.canvas.height });
    copy.className = "copy";
    glplot.redraw();
    copy.getContext("2d").drawImage(glplot.canvas, 0, 0);
    plot.after(copy);
  }));
  addEventListener("afterprint", () => document.querySelectorAll("canvas.copy").forEach((copy) => copy.remove()));

  return { place, columns, surface, solid, markers, layout, show, copied };
})();
