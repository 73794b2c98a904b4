// The whole robot in 3D, as it stood at a time of the log: with the prior's bodies, and beside it with those found.
(() => {
  const { color } = plots;
  const { columns, surface, solid, markers, layout, show } = solids;
  const { robot } = plots.data;
  const views = [...document.querySelectorAll("[data-robot]")];
  if (!views.length) return;
  const slider = document.getElementById("posture");
  const time = document.getElementById("posture-time");
  const axes = ["x", "y", "z"];

  // What is drawn alike of some bodies, the prior's or those found, one after the other in its own frame: [body, trace].
  function groups(which) {
    const found = new Map();
    const add = (group, body, traces) => found.set(group, [...(found.get(group) || []), ...traces.map((trace) => [body, trace])]);
    robot.bodies.forEach((body, b) => {
      const spread = (own, group, shade, opacity, dash) => {
        if (!own) return;
        const [outline, face] = solid({ kind: "ellipsoid", ...own }, group, shade, opacity, dash).reverse();
        add(`${group} outline`, b, [outline]);
        if (face) add(group, b, [face]);
        add(`${group} centre`, b, [markers([own.center], group, [`${body.name}: centre of mass, ${group}`], { color: shade, symbol: "diamond", size: 4 })]);
      };
      if (body.surface) {
        const [i, j, k] = [0, 1, 2].map((at) => body.surface.faces.map((face) => face[at]));
        add("geometry", b, [surface(body.surface.points, { i, j, k }, "geometry", color("measured"), 0.35)]);
      }
      body.bounds.filter((shape) => shape.kind !== "hull").forEach((shape) =>
        add("bounding shape", b, solid(shape, "bounding shape", color("measured"), 0, "solid")));
      if (which === "prior") spread(body.prior, "prior", color("prior"), 0.45, "solid");
      else spread(body.found, robot.shown, color("predicted"), 0.45, "solid");
    });
    return [...found.values()];
  }

  // Rows of the rotation of a quaternion, each with the position's entry.
  function rows([x, y, z, w, ...p]) {
    return [
      [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w), p[0]],
      [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w), p[1]],
      [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y), p[2]],
    ];
  }

  // One trace of a group, every body where it is in a posture.
  function posed(group, posture) {
    const whole = { ...group[0][1], x: [], y: [], z: [] };
    if (whole.i) Object.assign(whole, { i: [], j: [], k: [] });
    if (whole.text) whole.text = [];
    for (const [b, trace] of group) {
      const first = whole.x.length;
      const place = rows(robot.frames[posture][b]);
      trace.x.forEach((x, n) => axes.forEach((name, axis) => {
        const [a, b, c, p] = place[axis];
        whole[name].push(x === null ? null : a * x + b * trace.y[n] + c * trace.z[n] + p);
      }));
      if (whole.i) ["i", "j", "k"].forEach((name) => trace[name].forEach((at) => whole[name].push(at + first)));
      if (whole.text) whole.text.push(...trace.text);
    }
    return whole;
  }

  const drawn = new Map(); // by plot, its groups and its layout, as the page's colours and all postures have them

  function draw(plot) {
    const every = Math.max(1, Math.floor(robot.frames.length / 8));
    const everywhere = views.flatMap((each) => groups(each.dataset.robot));
    const inEveryPosture = robot.frames.flatMap((_, n) => (n % every ? [] : everywhere.map((group) => posed(group, n))));
    const isFirst = !drawn.has(plot);
    drawn.set(plot, { groups: groups(plot.dataset.robot), view: layout(inEveryPosture, plot.clientHeight) });
    move(plot);
    if (isFirst) ["plotly_relayouting", "plotly_relayout"].forEach((event) => plot.on(event, (change) => follow(plot, change)));
  }

  const scene = (plot) => plot._fullLayout?.scene?._scene;

  // It is looked at from where it was: plotly.js would go back to where the mouse let go, from where it turned on.
  function move(plot) {
    const { groups, view } = drawn.get(plot);
    const camera = scene(plot)?.getCamera();
    Object.assign(view.scene, { uirevision: undefined, ...(camera ? { camera } : {}) });
    time.textContent = `${robot.t[slider.value]} s`;
    show(plot, groups.map((group) => posed(group, slider.value)), view);
  }

  // All are looked at from the same place.
  let following = false;

  function follow(plot, change) {
    const camera = change["scene.camera"];
    if (following || !camera) return;
    const others = [...drawn.keys()].filter((other) => other !== plot);
    following = true;
    Promise.all(others.map((other) => Plotly.relayout(other, { "scene.camera": camera }))).finally(() => { following = false; });
  }

  slider.addEventListener("input", () => [...drawn.keys()].forEach(move));
  plots.watch(views, draw);
  solids.copied(() => views);
})();
