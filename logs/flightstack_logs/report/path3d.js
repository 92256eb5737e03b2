"use strict";
// The path in space: an orthographic view on a plain canvas, turned by dragging; north, east and up in metres.
(() => {
  const canvas = document.getElementById("path3d");
  const path = flight.data.path;
  if (!canvas || !path) return;
  const { colour, listeners, decode } = flight;
  const context = canvas.getContext("2d");
  const VIEWS = { default: [228, 24], top: [180, 90], south: [180, 0], west: [270, 0] };
  const view = { azimuth: 0, elevation: 0, zoom: 1, pan: [0, 0], scale: 1 };
  const tracks = path.tracks.map((track) => ({
    ...track, t: decode(track.t), n: decode(track.n), e: decode(track.e), u: decode(track.u),
  }));
  const flown = tracks[tracks.length - 1];
  const SLACK = 0.12; // of a grid step: noise of the estimate must not open another row of the grid
  let cursorTime = null;
  let span = [-Infinity, Infinity];

  // The box that everything lies in, with whole steps of the grid.
  const bounds = (() => {
    const low = [Infinity, Infinity, 0], high = [-Infinity, -Infinity, 0];
    const take = (axis, value) => {
      low[axis] = Math.min(low[axis], value);
      high[axis] = Math.max(high[axis], value);
    };
    for (const track of tracks) [track.n, track.e, track.u].forEach((values, axis) => values.forEach((v) => take(axis, v)));
    if (path.region) {
      path.region.centre.forEach((c, axis) => [-1, 1].forEach((side) => take(axis, c + side * path.region.half[axis])));
    }
    const largest = Math.max(...high.map((h, axis) => h - low[axis]), 0.5);
    const rough = largest / 6;
    const decade = 10 ** Math.floor(Math.log10(rough));
    const step = decade * [1, 2, 5, 10].find((m) => m * decade >= rough);
    return {
      step, decimals: Math.max(0, -Math.floor(Math.log10(step) + 1e-9)),
      low: low.map((v) => Math.floor(v / step + SLACK) * step),
      high: high.map((v, axis) => Math.max(Math.ceil(v / step - SLACK), Math.floor(low[axis] / step + SLACK) + 1) * step),
    };
  })();
  const centre = bounds.low.map((l, axis) => (l + bounds.high[axis]) / 2);

  let axesOfView = [[0, 0, 0], [0, 0, 0]];
  function turn(azimuth, elevation) {
    view.azimuth = (azimuth + 360) % 360;
    view.elevation = Math.max(-10, Math.min(90, elevation));
    const a = (view.azimuth * Math.PI) / 180, b = (view.elevation * Math.PI) / 180;
    // The camera stands at azimuth a (from north by east); rows: what points right and up on the screen.
    axesOfView = [
      [Math.sin(a), -Math.cos(a), 0],
      [-Math.sin(b) * Math.cos(a), -Math.sin(b) * Math.sin(a), Math.cos(b)],
    ];
  }
  const flat = (p) => axesOfView.map((axis) => axis.reduce((sum, c, i) => sum + c * (p[i] - centre[i]), 0));
  function project(p) {
    const [x, y] = flat(p);
    const k = view.scale * view.zoom;
    return [canvas.clientWidth / 2 + view.pan[0] + k * x, canvas.clientHeight / 2 + view.pan[1] - k * y];
  }
  const corners = () => [0, 1, 2, 3, 4, 5, 6, 7].map((i) =>
    [0, 1, 2].map((axis) => ((i >> axis) & 1 ? bounds.high : bounds.low)[axis]));

  function fit() {
    const flatCorners = corners().map(flat);
    const extent = [0, 1].map((i) => Math.max(...flatCorners.map((c) => Math.abs(c[i]))) || 1e-3);
    view.scale = Math.min((canvas.clientWidth / 2 - 52) / extent[0], (canvas.clientHeight / 2 - 34) / extent[1]);
    view.zoom = 1;
    view.pan = [0, 0];
  }

  function line(points, style, width, dash = []) {
    context.strokeStyle = style;
    context.lineWidth = width;
    context.setLineDash(dash);
    context.beginPath();
    points.forEach((p, i) => {
      const [x, y] = project(p);
      if (i) context.lineTo(x, y); else context.moveTo(x, y);
    });
    context.stroke();
    context.setLineDash([]);
  }
  function text(words, at, align = "center", style = colour("muted")) {
    context.fillStyle = style;
    context.strokeStyle = colour("card");
    context.lineWidth = 3;
    context.lineJoin = "round";
    context.textAlign = align;
    context.textBaseline = "middle";
    context.strokeText(words, at[0], at[1]);
    context.fillText(words, at[0], at[1]);
  }
  function ticks(axis) {
    const count = Math.round((bounds.high[axis] - bounds.low[axis]) / bounds.step);
    return Array.from({ length: count + 1 }, (_, i) => bounds.low[axis] + i * bounds.step);
  }

  // Floor grid, and for each axis the box edge that stands free of the picture, with numbers.
  function drawAxes() {
    const floor = bounds.low[2];
    for (const axis of [0, 1]) {
      for (const value of ticks(axis)) {
        const a = [0, 0, floor], b = [0, 0, floor];
        a[axis] = b[axis] = value;
        a[1 - axis] = bounds.low[1 - axis];
        b[1 - axis] = bounds.high[1 - axis];
        line([a, b], colour("line"), 1);
      }
    }
    ["north (m)", "east (m)", "up (m)"].forEach(drawScale);
  }
  function drawScale(name, axis) {
    const others = [0, 1, 2].filter((i) => i !== axis);
    const edges = [0, 1, 2, 3].map((i) => {
      const a = [0, 0, 0], b = [0, 0, 0];
      a[axis] = bounds.low[axis];
      b[axis] = bounds.high[axis];
      others.forEach((other, j) => (a[other] = b[other] = ((i >> j) & 1 ? bounds.high : bounds.low)[other]));
      return [a, b];
    }).filter(([a]) => axis === 2 || a[2] === bounds.low[2]);
    const middle = ([a, b]) => project(a.map((v, i) => (v + b[i]) / 2));
    // Horizontal axes: the edge nearest to the viewer (lowest on the screen).  Height: the leftmost edge.
    const key = axis === 2 ? (edge) => -middle(edge)[0] : (edge) => middle(edge)[1] - 1e-3 * middle(edge)[0];
    const edge = edges.reduce((best, next) => (key(next) > key(best) ? next : best));
    const [a, b] = edge.map(project);
    const along = Math.hypot(b[0] - a[0], b[1] - a[1]);
    if (along < 40) return;
    let out = [-(b[1] - a[1]) / along, (b[0] - a[0]) / along];
    const from = project(centre), mid = middle(edge);
    if (out[0] * (mid[0] - from[0]) + out[1] * (mid[1] - from[1]) < 0) out = [-out[0], -out[1]];
    line(edge, colour("shadow"), 1);
    const every = Math.ceil(22 / (along / (ticks(axis).length - 1)));
    const corner = axis < 2 && Math.abs(a[1] - b[1]) > 5 ? (a[1] > b[1] ? bounds.low : bounds.high)[axis] : null;
    ticks(axis).forEach((value, i) => {
      // Both horizontal axes end in the nearest corner, where their numbers would lie on each other.
      if (i % every || value === corner) return;
      const at = [...edge[0]];
      at[axis] = value;
      const [x, y] = project(at);
      text(flight.fixed(value, bounds.decimals), [x + 16 * out[0], y + 12 * out[1]]);
    });
    if (axis === 2) {
      const top = a[1] < b[1] ? a : b;
      text(name, [top[0], top[1] - 16], "center", colour("ink"));
      return;
    }
    text(name, [mid[0] + 38 * out[0], mid[1] + 28 * out[1]], Math.abs(out[0]) > 0.5 ? (out[0] < 0 ? "right" : "left") : "center", colour("ink"));
  }

  function drawRegion() {
    const { region } = path;
    if (!region) return;
    const style = colour("region");
    const at = (signs) => region.centre.map((c, axis) => c + signs[axis] * region.half[axis]);
    if (region.shape === "ellipsoid") {
      for (const [i, j] of [[0, 1], [0, 2], [1, 2]]) {
        line(Array.from({ length: 73 }, (_, k) => {
          const signs = [0, 0, 0];
          signs[i] = Math.cos((k * Math.PI) / 36);
          signs[j] = Math.sin((k * Math.PI) / 36);
          return at(signs);
        }), style, 1.25, [2, 3]);
      }
      return;
    }
    for (const [i, j, k] of [[0, 1, 2], [1, 0, 2], [2, 0, 1]]) {
      for (const first of [-1, 1]) for (const second of [-1, 1]) {
        const a = [0, 0, 0];
        a[j] = first;
        a[k] = second;
        const b = [...a];
        a[i] = -1;
        b[i] = 1;
        line([at(a), at(b)], style, 1.25, [2, 3]);
      }
    }
  }

  const widths = { command: 1.25, measured: 4, truth: 1.6 };
  function drawTrack(track, shadow) {
    const point = (i) => [track.n[i], track.e[i], shadow ? bounds.low[2] : track.u[i]];
    const indices = track.t.map((_, i) => i);
    const inside = indices.filter((i) => track.t[i] >= span[0] && track.t[i] <= span[1]);
    const style = colour(shadow ? "shadow" : track.role);
    const width = shadow ? 1 : widths[track.role], dash = !shadow && track.role === "command" ? [5, 4] : [];
    if (inside.length < indices.length && !shadow) {
      context.globalAlpha = 0.15;
      line(indices.map(point), style, width, dash);
    }
    context.globalAlpha = !shadow && track.role === "measured" ? 0.6 : 1;
    line(inside.map(point), style, width, dash);
    context.globalAlpha = 1;
  }
  function mark(p, style, shape, words) {
    const [x, y] = project(p);
    context.fillStyle = style;
    context.strokeStyle = colour("card");
    context.lineWidth = 2;
    context.beginPath();
    if (shape === "square") context.rect(x - 5, y - 5, 10, 10); else context.arc(x, y, shape === "dot" ? 5 : 6, 0, 7);
    context.fill();
    context.stroke();
    if (words) text(words, [x + 10, y + (shape === "square" ? 9 : -9)], "left", colour("ink"));
  }
  function at(track, t) {
    if (t < track.t[0] || t > track.t[track.t.length - 1]) return null;
    let low = 0, high = track.t.length - 1;
    while (high - low > 1) {
      const half = (low + high) >> 1;
      if (track.t[half] <= t) low = half; else high = half;
    }
    const f = track.t[high] > track.t[low] ? (t - track.t[low]) / (track.t[high] - track.t[low]) : 0;
    return [track.n, track.e, track.u].map((values) => values[low] + f * (values[high] - values[low]));
  }

  function draw() {
    const dpr = devicePixelRatio || 1;
    const width = canvas.clientWidth, height = canvas.clientHeight;
    if (canvas.width !== Math.round(width * dpr) || canvas.height !== Math.round(height * dpr)) {
      canvas.width = Math.round(width * dpr);
      canvas.height = Math.round(height * dpr);
    }
    context.setTransform(dpr, 0, 0, dpr, 0, 0);
    context.clearRect(0, 0, width, height);
    context.font = flight.FONT;
    context.lineJoin = "round";
    drawAxes();
    drawTrack(flown, true);
    drawRegion();
    for (const role of ["measured", "truth", "command"]) tracks.filter((t) => t.role === role).forEach((t) => drawTrack(t, false));
    const last = flown.t.length - 1;
    mark([flown.n[last], flown.e[last], flown.u[last]], colour("ink"), "square", "landing");
    mark([flown.n[0], flown.e[0], flown.u[0]], colour("two"), "circle", "start");
    if (cursorTime !== null) {
      for (const track of tracks) {
        const p = at(track, cursorTime);
        if (p) mark(p, colour(track.role), "dot");
      }
    }
  }

  function show(name) {
    turn(...VIEWS[name]);
    fit();
    draw();
  }
  const drag = { from: null };
  canvas.addEventListener("pointerdown", (event) => {
    drag.from = [event.clientX, event.clientY, view.azimuth, view.elevation, ...view.pan];
    canvas.setPointerCapture(event.pointerId);
  });
  canvas.addEventListener("pointermove", (event) => {
    if (!drag.from) return;
    const [x, y, azimuth, elevation, panX, panY] = drag.from;
    const dx = event.clientX - x, dy = event.clientY - y;
    if (event.shiftKey) view.pan = [panX + dx, panY + dy];
    else turn(azimuth + 0.4 * dx, elevation + 0.4 * dy);
    draw();
  });
  for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, () => (drag.from = null));
  // A wheel that is already scrolling the page goes on scrolling it.
  let scrolled = -Infinity;
  window.addEventListener("scroll", () => (scrolled = performance.now()));
  canvas.addEventListener("wheel", (event) => {
    if (performance.now() - scrolled < 300) return;
    event.preventDefault();
    view.zoom = Math.max(0.3, Math.min(30, view.zoom * Math.exp(-0.0015 * event.deltaY)));
    draw();
  }, { passive: false });
  canvas.addEventListener("dblclick", () => show("default"));
  canvas.addEventListener("keydown", (event) => {
    const move = { ArrowLeft: [-10, 0], ArrowRight: [10, 0], ArrowUp: [0, 10], ArrowDown: [0, -10] }[event.key];
    if (!move) return;
    event.preventDefault();
    turn(view.azimuth + move[0], view.elevation + move[1]);
    draw();
  });
  for (const button of document.querySelectorAll("[data-view]")) {
    button.addEventListener("click", () => show(button.dataset.view));
  }
  listeners.cursor.push((t) => ((cursorTime = t), draw()));
  listeners.zoom.push((from, to) => ((span = [from, to]), draw()));
  listeners.theme.push(() => (fit(), draw()));
  show("default");
  document.body.dataset.path = tracks.length + " tracks";
})();
