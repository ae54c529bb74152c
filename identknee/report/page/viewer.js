// Draws the knee whose scene lies beside this script, one trial at a time.
(() => {
  "use strict";
  const root = document.currentScript.closest(".knee-viewer");
  const scene = JSON.parse(root.querySelector("script[type='application/json']").textContent);
  const find = (what) => root.querySelector(what);
  const plot = find(".kv-plot");
  const slider = find("input");
  const play = find(".kv-play");
  const SECONDS = 0.9; // a trial, while it plays
  const APART = -0.4; // mm; the depth of a place for which none was sent
  const BEYOND = 5; // mm from the end of a line to its name
  const NAME = 7; // mm from one name down to the next
  const LETTER = 2.0; // mm, the width of a letter
  const TRIES = 12;
  const POSITION = [
    ["lateral shift", "mm"],
    ["anterior drawer", "mm"],
    ["distraction", "mm"],
    ["varus angulation", "°"],
    ["internal rotation", "°"],
  ];
  // Both sequences grow away from the paper, in lightness alone enough to be told apart.
  const LIGHT = {
    forces: ["#f2b277", "#e0703c", "#ad2433", "#560a2c"],
    depths: ["#79b0dc", "#2273b8", "#08285c"],
    cartilage: "#bccad4", lost: "#c9c9c9", missing: "#c2187f",
  };
  const DARK = {
    forces: ["#a8434a", "#dd5f45", "#f79c57", "#ffe9a8"],
    depths: ["#2a6ea8", "#5fb0e6", "#d8f1ff"],
    cartilage: "#8a9dab", lost: "#666666", missing: "#ff79c6",
  };
  // Towards the viewer: anterior, superior, lateral.
  const VIEWS = {
    oblique: [0.8, 0.32, 0.62],
    front: [1, 0.12, 0],
    lateral: [0, 0.12, 1],
    medial: [0, 0.12, -1],
    back: [-1, 0.12, 0],
    above: [0.05, 1, 0],
  };
  let current = 0;
  let timer = null;
  let seen; // the camera

  // ---- Colours ----

  const variable = (name) => getComputedStyle(root).getPropertyValue(name).trim();

  function channels(colour) {
    if (colour.startsWith("#")) {
      return [1, 3, 5].map((at) => parseInt(colour.slice(at, at + 2), 16));
    }
    return colour.match(/[\d.]+/g).slice(0, 3).map(Number);
  }

  function palette() {
    const [r, g, b] = channels(getComputedStyle(root).backgroundColor);
    const isDark = 0.299 * r + 0.587 * g + 0.114 * b < 128;
    return {
      ...(isDark ? DARK : LIGHT),
      ink: variable("--kv-ink"), paper: variable("--kv-paper"), muted: variable("--kv-muted"),
    };
  }

  function between(colours, share) {
    const at = Math.min(Math.max(share, 0), 1) * (colours.length - 1);
    const low = Math.min(Math.floor(at), colours.length - 2);
    const [one, other] = [channels(colours[low]), channels(colours[low + 1])];
    const mixed = one.map((x, i) => Math.round(x + (at - low) * (other[i] - x)));
    return `rgb(${mixed.join(", ")})`;
  }

  // ---- Geometry, in femoral axes ----

  const cross = (a, b) =>
    [0, 1, 2].map((i) => a[(i + 1) % 3] * b[(i + 2) % 3] - a[(i + 2) % 3] * b[(i + 1) % 3]);
  const dot = (a, b) => a.reduce((sum, x, i) => sum + x * b[i], 0);
  const unit = (a) => a.map((x) => x / Math.hypot(...a));

  function moved(trial, [x, y, z]) {
    return trial.rotation.map((row, i) =>
      row[0] * x + row[1] * y + row[2] * z + trial.translation[i]);
  }

  // The library turns the picture about its z, which therefore is superior.
  const plotted = ([anterior, superior, lateral]) => ({ x: lateral, y: anterior, z: superior });

  const columns = (points) => plotted([0, 1, 2].map((axis) => points.map((p) => p[axis])));

  function mesh({ x, y, z, i, j, k }, placed) {
    const places = x.map((_, v) => placed([x[v], y[v], z[v]]));
    return { ...columns(places), i, j, k };
  }

  function course(trial, line) {
    const end = moved(trial, line.tibial);
    const points = [line.femoral, end];
    if (line.ways) {
      points.splice(1, 0, ...line.ways[scene.trials.indexOf(trial)]);
    } else if (line.lift !== 0) {
      const aside = end.map((x, i) => x + line.place * (line.femoral[i] - x));
      aside[2] += line.lift;
      points.splice(1, 0, aside);
    }
    return points;
  }

  // ---- The drawing ----

  const LIGHTING = { ambient: 0.45, diffuse: 0.8, specular: 0.15, roughness: 0.5, fresnel: 0.05 };
  // In the camera's axes, so that it turns with the viewer; z is stretched far more than x and y.
  const LIGHT_AT = { x: -1e5, y: 1e5, z: -1e3 };
  const QUIET = { hoverinfo: "skip", showlegend: false, showscale: false };

  function surfaces(trial, colours) {
    const lost = trial.outcome !== null;
    // One colour for both: where they touch, nobody can tell which of them is in front.
    const base = lost ? colours.lost : colours.cartilage;
    const depth = new Array(scene.tibia.x.length).fill(APART);
    trial.near.forEach((vertex, n) => { depth[vertex] = trial.depths[n] / 1000; });
    const touch = -APART / (scene.depth - APART);
    const last = colours.depths.length - 1;
    const patch = colours.depths.map((colour, n) =>
      [touch + ((1 - touch) * n) / last, lost ? base : colour]);
    const shared = { type: "mesh3d", ...QUIET, lighting: LIGHTING, lightposition: LIGHT_AT };
    return [
      {
        ...shared, name: "femur", ...mesh(scene.femur, (place) => place), opacity: 0.42, color: base,
      },
      {
        ...shared, name: "tibia", ...mesh(scene.tibia, (place) => moved(trial, place)), intensity: depth,
        cmin: APART, cmax: scene.depth,
        colorscale: [[0, base], [touch, base], ...patch],
      },
    ];
  }

  function stroke(name, points, line) {
    return { type: "scatter3d", mode: "lines", name, ...QUIET, ...columns(points), line };
  }

  function ligaments(trial, colours) {
    return scene.lines.map((line) => {
      const force = trial.forces[line.of];
      const isTaut = force !== null && force !== 0;
      const style = isTaut
        ? { width: 9, color: between(colours.forces, Math.abs(force) / scene.force), dash: "solid" }
        : { width: 3, color: colours.muted, dash: force === 0 ? "dash" : "solid" };
      return stroke(scene.ligaments[line.of], course(trial, line), style);
    });
  }

  // Names lie beyond the tibial ends, in front of everything; that of a ligament of several lines
  // beyond the first of them.
  function names(trial, colours) {
    const taken = [];
    return scene.ligaments.map((name, n) => {
      const line = scene.lines.find((x) => x.of === n);
      const [start, end] = course(trial, line).slice(-2);
      const along = unit(end.map((x, i) => x - start[i]));
      const at = (away) => end.map((value, i) => value + away * along[i]);
      // Lines insert side by side: the name of the next one stands beyond that of the first. Views
      // turn about the vertical, so names must not share a height where they may lie side by side.
      const meets = (own) => taken.some(({ place, letters }) => {
        const [anterior, superior, lateral] = own.map((x, i) => x - place[i]);
        const isBeside = Math.hypot(anterior, lateral) < LETTER * 0.5 * (letters + name.length);
        return Math.abs(superior) < NAME && isBeside;
      });
      let away = BEYOND;
      for (let k = 0; k < TRIES && meets(at(away)); k += 1) away += NAME;
      taken.push({ place: at(away), letters: name.length });
      return {
        ...plotted(at(away)),
        text: name, showarrow: false, font: { color: colours.ink, size: 13 },
      };
    });
  }

  function traces(trial, colours) {
    const [femoral, tibial] = scene.shafts;
    const bone = { width: 14, color: colours.muted };
    const drawn = [
      ...surfaces(trial, colours),
      { ...stroke("shaft of the femur", femoral, bone), opacity: 0.28 },
      { ...stroke("shaft of the tibia", tibial.map((x) => moved(trial, x)), bone), opacity: 0.28 },
      ...ligaments(trial, colours),
    ];
    if (scene.missing) {
      const ends = [scene.missing[0], moved(trial, scene.missing[1])];
      drawn.push(stroke("missing line", ends, { width: 11, color: colours.missing }));
    }
    return drawn;
  }

  function camera(view) {
    const [anterior, superior, lateral] = unit(VIEWS[view]).map((x) => 2 * x);
    return {
      eye: plotted([anterior, superior, lateral * scene.lateral]),
      up: plotted([0, 1, 0]), center: { x: 0, y: 0, z: 0 },
      projection: { type: "orthographic" },
    };
  }

  function layout(trial, colours) {
    const [low, high] = scene.box;
    const sizes = low.map((x, i) => high[i] - x);
    const ranges = plotted(low.map((x, i) => [x, high[i]]));
    const axis = (range) => ({ visible: false, range, autorange: false });
    return {
      margin: { l: 0, r: 0, t: 0, b: 0 }, uirevision: "kept", showlegend: false,
      paper_bgcolor: colours.paper, font: { family: getComputedStyle(root).fontFamily, color: colours.ink },
      scene: {
        xaxis: axis(ranges.x), yaxis: axis(ranges.y), zaxis: axis(ranges.z), camera: seen,
        annotations: names(trial, colours), bgcolor: colours.paper, dragmode: "turntable",
        aspectmode: "manual", aspectratio: plotted(sizes.map((x) => (2 * x) / Math.max(...sizes))),
      },
    };
  }

  // ---- The compass ----

  function turnCompass() {
    const vector = (name) => [seen[name].y, seen[name].z, seen[name].x];
    const toward = unit(vector("eye").map((x, i) => x - vector("center")[i]));
    const right = unit(cross(vector("up"), toward));
    const up = cross(toward, right);
    const arrows = [
      ["anterior", [1, 0, 0]], ["superior", [0, 1, 0]], ["lateral", [0, 0, scene.lateral]],
    ];
    find(".kv-compass").innerHTML = arrows.map(([name, axis]) => {
      const [x, y] = [dot(axis, right), -dot(axis, up)];
      const long = Math.hypot(x, y);
      // Beyond the tip by half of the word.
      const away = 30 + (24 * Math.abs(x) + 10 * Math.abs(y)) / Math.max(long, 0.01) / Math.max(long, 0.3);
      return `<line x2="${(30 * x).toFixed(1)}" y2="${(30 * y).toFixed(1)}"/>`
        + `<text x="${(away * x).toFixed(1)}" y="${(away * y).toFixed(1)}"`
        + ` opacity="${long < 0.25 ? 0 : 1}">${name}</text>`;
    }).join("");
  }

  // ---- Words ----

  const inNewtons = (force) => {
    if (force === null) return "no value";
    if (force === 0) return "slack";
    return force > 0 ? `${force.toFixed(0)} N` : `pushes ${(-force).toFixed(0)} N`;
  };

  // Small values without a sign of their own.
  const inUnit = (value, unitOf) =>
    `${value.toFixed(1).replace(/^-(0\.0)$/, "$1").replace("-", "−")} ${unitOf}`;

  function row(name, value, share, colour) {
    const line = document.createElement("tr");
    const head = line.appendChild(document.createElement("th"));
    head.scope = "row";
    head.textContent = name;
    if (share !== undefined) {
      const cell = line.appendChild(document.createElement("td"));
      cell.className = "kv-bar";
      const bar = cell.appendChild(document.createElement("span"));
      bar.style.width = `${100 * share}%`;
      bar.style.background = colour;
    }
    line.appendChild(document.createElement("td")).textContent = value;
    return line;
  }

  function tell(trial, colours) {
    find(".kv-loads").textContent = trial.loads;
    find(".kv-name").textContent =
      `${trial.name} · trial ${current + 1} of ${scene.trials.length}`;
    const lost = trial.outcome === null ? "" : `${trial.outcome} It is drawn where it last stood.`;
    find(".kv-outcome").textContent = lost;
    find(".kv-outcome").hidden = !lost;
    find(".kv-forces tbody").replaceChildren(...scene.ligaments.map((name, n) => {
      const share = Math.abs(trial.forces[n] ?? 0) / scene.force;
      return row(name, inNewtons(trial.forces[n]), share, between(colours.forces, share));
    }));
    find(".kv-position tbody").replaceChildren(...POSITION.map(([name, unitOf], n) =>
      row(name, inUnit(trial.coordinates[n], unitOf))));
    const forces = scene.ligaments.map((name, n) => `${name} ${inNewtons(trial.forces[n])}`);
    slider.setAttribute("aria-valuetext", trial.loads);
    if (timer === null) {
      find(".kv-said").textContent = `${trial.loads}. ${lost} ${forces.join(", ")}.`;
    }
  }

  function keys(colours) {
    const strip = (list) => `linear-gradient(to right, ${list.join(", ")})`;
    find(".kv-force-scale").style.background = strip(colours.forces);
    find(".kv-depth-scale").style.background = strip(colours.depths);
    find(".kv-most-force").textContent = scene.force.toFixed(0);
    find(".kv-most-depth").textContent = scene.depth.toFixed(2);
    find(".kv-missing-key").hidden = scene.missing === null;
    root.style.setProperty("--kv-missing", colours.missing);
  }

  // ---- What happens ----

  function draw() {
    const [trial, colours] = [scene.trials[current], palette()];
    keys(colours);
    tell(trial, colours);
    const config = { displayModeBar: false, scrollZoom: false, responsive: true };
    return Plotly.react(plot, traces(trial, colours), layout(trial, colours), config);
  }

  function show(number) {
    const n = scene.trials.length;
    current = (number + n) % n;
    slider.value = current;
    return draw();
  }

  function stop() {
    clearInterval(timer);
    timer = null;
    play.textContent = "Play";
    play.setAttribute("aria-pressed", "false");
  }

  function start() {
    timer = setInterval(() => show(current + 1), 1000 * SECONDS);
    play.textContent = "Pause";
    play.setAttribute("aria-pressed", "true");
  }

  function listen() {
    slider.addEventListener("input", () => { stop(); show(Number(slider.value)); });
    play.addEventListener("click", () => { timer === null ? start() : (stop(), draw()); });
    root.querySelectorAll("[data-step]").forEach((button) =>
      button.addEventListener("click", () => { stop(); show(current + Number(button.dataset.step)); }));
    root.querySelectorAll("[data-view]").forEach((button) =>
      button.addEventListener("click", () => {
        Plotly.relayout(plot, { "scene.camera": camera(button.dataset.view) });
      }));
    const turned = (change) => {
      seen = change["scene.camera"] ?? seen;
      turnCompass();
    };
    plot.on("plotly_relayouting", turned);
    plot.on("plotly_relayout", turned);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
    new ResizeObserver(() => Plotly.Plots.resize(plot)).observe(plot);
  }

  function begin() {
    seen = camera("oblique");
    turnCompass();
    draw().then(() => {
      listen();
      root.dataset.ready = "true";
    });
  }

  if (document.readyState === "loading") document.addEventListener("DOMContentLoaded", begin);
  else begin();
})();
