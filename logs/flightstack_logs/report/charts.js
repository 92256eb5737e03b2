"use strict";
// Charts over time.  The page's data says what is drawn; here is only how: colours, phases, limits, common cursor and zoom.
const flight = (() => {
  const errors = [];
  const body = document.body;
  const report = (text) => {
    errors.push(text);
    body.dataset.errors = errors.join("; ");
    const box = document.createElement("p");
    box.className = "script-error";
    box.textContent = "This page could not draw everything: " + text;
    document.querySelector("main").prepend(box);
  };
  window.addEventListener("error", (event) => report(event.message));
  body.dataset.errors = "";

  const data = JSON.parse(document.getElementById("flight-data").textContent);
  const decode = (base64) => {
    const bytes = Uint8Array.from(atob(base64), (c) => c.charCodeAt(0));
    return Array.from(new Float32Array(bytes.buffer), (v) => (Number.isNaN(v) ? null : v));
  };

  let colours = {};
  const colour = (name) => {
    if (!(name in colours)) colours[name] = getComputedStyle(document.documentElement).getPropertyValue("--" + name).trim();
    return colours[name];
  };
  const FONT = '11px system-ui, "DejaVu Sans", sans-serif';
  const shadedPhases = new Set(["takeoff", "approach", "landing"]);
  const fixed = (value, decimals) => (value == null ? "–" : value.toFixed(decimals).replace("-", "−"));

  const charts = [];
  const listeners = { cursor: [], zoom: [], theme: [] };
  const tell = (kind, ...what) => listeners[kind].forEach((listener) => listener(...what));
  let whole = [Infinity, -Infinity];
  let zooming = false;

  function zoom(from, to) {
    if (zooming) return;
    zooming = true;
    for (const chart of charts) chart.setScale("x", { min: from, max: to });
    zooming = false;
    tell("zoom", from, to);
  }
  const showWhole = () => zoom(whole[0], whole[1]);

  // Behind the curves: phases, and spans at a limit.
  function drawBehind(u, spec) {
    const { ctx, bbox } = u;
    const band = (from, to, fill) => {
      const a = Math.max(u.valToPos(from, "x", true), bbox.left);
      const b = Math.min(u.valToPos(to, "x", true), bbox.left + bbox.width);
      ctx.fillStyle = fill;
      if (b >= a) ctx.fillRect(a, bbox.top, Math.max(b - a, 1), bbox.height);
    };
    ctx.save();
    for (const [name, from, to] of data.phases) if (shadedPhases.has(name)) band(from, to, colour("phase"));
    for (const [from, to] of spec.shaded) band(from, to, colour("hit"));
    ctx.restore();
  }

  // Along the bottom: what was the case when, in words where they fit.
  function drawStrip(u, spec) {
    const { ctx, bbox } = u;
    const dpr = devicePixelRatio || 1;
    const height = 15 * dpr, top = bbox.top + bbox.height - height, right = bbox.left + bbox.width;
    ctx.save();
    ctx.font = FONT.replace("11px", 11 * dpr + "px");
    ctx.textAlign = "left";
    for (const [from, to, label, role] of spec.strip) {
      const a = Math.max(u.valToPos(from, "x", true), bbox.left);
      const b = Math.min(u.valToPos(to, "x", true), right);
      if (b <= a) continue;
      ctx.fillStyle = colour(role);
      ctx.fillRect(a, top, b - a, height);
      if (ctx.measureText(label).width + 8 * dpr > b - a) continue;
      ctx.fillStyle = colour("ink");
      ctx.fillText(label, a + 4 * dpr, top + 11.5 * dpr);
    }
    ctx.restore();
  }

  // Moments with a word: vertical lines, named once where the words would collide.
  function drawMarks(u, spec) {
    const { ctx, bbox } = u;
    const dpr = devicePixelRatio || 1;
    let free = bbox.left;
    ctx.font = FONT.replace("11px", 11 * dpr + "px");
    ctx.textAlign = "left";
    for (const [t, label] of spec.marks) {
      const x = u.valToPos(t, "x", true);
      if (x < bbox.left || x > bbox.left + bbox.width) continue;
      ctx.strokeStyle = ctx.fillStyle = colour("limit");
      ctx.lineWidth = dpr;
      ctx.setLineDash([3 * dpr, 3 * dpr]);
      ctx.beginPath();
      ctx.moveTo(x, bbox.top);
      ctx.lineTo(x, bbox.top + bbox.height);
      ctx.stroke();
      ctx.setLineDash([]);
      if (x < free) continue;
      ctx.lineJoin = "round";
      ctx.lineWidth = 3 * dpr;
      ctx.strokeStyle = colour("card");
      ctx.strokeText(label, x + 4 * dpr, bbox.top + 11 * dpr);
      ctx.fillText(label, x + 4 * dpr, bbox.top + 11 * dpr);
      free = x + ctx.measureText(label).width + 12 * dpr;
    }
  }

  // Over the curves: limit lines with their names, marks, event triangles.
  function drawOver(u, spec) {
    drawStrip(u, spec);
    const { ctx, bbox } = u;
    const dpr = devicePixelRatio || 1;
    ctx.save();
    ctx.beginPath();
    ctx.rect(bbox.left, bbox.top - 8 * dpr, bbox.width, bbox.height + 9 * dpr);
    ctx.clip();
    drawMarks(u, spec);
    ctx.font = FONT.replace("11px", 11 * dpr + "px");
    ctx.textAlign = "right";
    for (const { value, label, role } of spec.lines) {
      const y = u.valToPos(value, "y", true);
      if (y < bbox.top - 1 || y > bbox.top + bbox.height + 1) continue;
      ctx.strokeStyle = ctx.fillStyle = colour(role);
      ctx.lineWidth = dpr;
      ctx.setLineDash([5 * dpr, 4 * dpr]);
      ctx.beginPath();
      ctx.moveTo(bbox.left, y);
      ctx.lineTo(bbox.left + bbox.width, y);
      ctx.stroke();
      const below = y - bbox.top < 14 * dpr;
      const right = bbox.left + bbox.width - 5 * dpr;
      const base = y + (below ? 12 : -4) * dpr;
      ctx.setLineDash([]);
      ctx.lineJoin = "round";
      ctx.lineWidth = 3 * dpr;
      ctx.strokeStyle = colour("card");
      ctx.strokeText(label.replace("-", "−"), right, base);
      ctx.fillText(label.replace("-", "−"), right, base);
    }
    for (const [t, severity] of data.events) {
      const x = u.valToPos(t, "x", true);
      if (x < bbox.left - 1 || x > bbox.left + bbox.width + 1) continue;
      ctx.fillStyle = colour(severity === "info" ? "muted" : "limit");
      ctx.beginPath();
      ctx.moveTo(x - 3.5 * dpr, bbox.top - 6 * dpr);
      ctx.lineTo(x + 3.5 * dpr, bbox.top - 6 * dpr);
      ctx.lineTo(x, bbox.top);
      ctx.fill();
    }
    ctx.restore();
  }

  function verticalRange(spec) {
    const values = [...spec.lines.map((line) => line.value), ...spec.scale];
    return (u, low, high) => {
      if (low == null || high == null) return [0, 1];
      if (spec.cut) [low, high] = spec.cut;
      low = Math.min(low, ...values);
      high = Math.max(high, ...values);
      if (spec.floor != null) low = Math.min(spec.floor, low);
      const pad = 0.06 * (high - low || Math.abs(high) || 1);
      return [spec.floor != null && low >= spec.floor ? spec.floor : low - pad, high + pad];
    };
  }

  function axes(spec) {
    const common = {
      stroke: () => colour("muted"), font: FONT,
      grid: { stroke: () => colour("grid"), width: 1 },
      ticks: { stroke: () => colour("line"), width: 1, size: 4 },
      border: { show: true, stroke: () => colour("line"), width: 1 },
    };
    const tidy = (v) => String(v).replace("-", "−");
    return [
      { ...common, size: 26, gap: 4, values: (u, ticks) => ticks.map((v) => tidy(Number(v.toFixed(6))) + " s") },
      { ...common, size: 50, gap: 4, space: 26, values: (u, ticks) => ticks.map((v) => tidy(Number(v.toFixed(6)))) },
    ];
  }

  function series(spec) {
    const unit = spec.curves.length > 3 || spec.unit.length > 6 ? "" : spec.unit === "°" ? "°" : " " + spec.unit;
    const shown = (v) => (v == null ? "" : fixed(v, spec.decimals) + unit);
    return spec.curves.map((curve) => ({
      label: curve.label,
      class: "u-" + (curve.edge || "line"),
      auto: !curve.edge,
      stroke: () => colour(curve.role) + (curve.edge ? "80" : ""),
      width: curve.edge ? 1 : curve.wide ? 3 : 1.25,
      alpha: curve.wide ? 0.75 : 1,
      points: { show: false },
      pxAlign: 0,
      value: (u, v, i, at) => shown(curve.edge === "upper" && v != null ? (v - u.data[i + 1][at]) / 2 : v),
    }));
  }

  // An upper edge and the lower one after it enclose a band.
  function bands(spec) {
    const uppers = spec.curves.map((curve, i) => (curve.edge === "upper" ? i : -1)).filter((i) => i >= 0);
    return uppers.map((i) => ({ series: [i + 1, i + 2], fill: () => colour(spec.curves[i].role) + (spec.scale.length ? "16" : "38") }));
  }

  const nameOf = (holder) => {
    const head = holder.closest("section").querySelector("h2");
    const unit = head.querySelector(".unit");
    return head.firstChild.textContent.trim() + (unit ? ", " + unit.textContent : "") + " over time";
  };
  const markerWidth = (curve) => (curve && curve.edge ? 9 : curve && curve.wide ? 4 : 2);
  const heightOf = (holder) => (holder.closest(".column") ? 245 : 170);

  function makeChart(holder, spec) {
    const t = decode(spec.t);
    whole = [Math.min(whole[0], t[0]), Math.max(whole[1], t[t.length - 1])];
    const chart = new uPlot({
      width: holder.clientWidth,
      height: heightOf(holder),
      padding: [9, 10, 0, 0],
      scales: { x: { time: false }, y: { range: verticalRange(spec) } },
      axes: axes(spec),
      series: [{ label: "time" }, ...series(spec)],
      bands: bands(spec),
      legend: { markers: { width: (u, i) => markerWidth(spec.curves[i - 1]) } },
      cursor: {
        y: false, points: { size: 6 }, drag: { x: true, y: false },
        bind: { dblclick: () => () => (showWhole(), null) },
        sync: { key: "flight", setSeries: false, filters: { pub: (type) => type === "mousemove" || type === "mouseleave" } },
      },
      hooks: {
        drawClear: [(u) => drawBehind(u, spec)],
        draw: [(u) => drawOver(u, spec)],
        setScale: [(u, key) => key === "x" && u.status === 1 && zoom(u.scales.x.min, u.scales.x.max)],
        setCursor: [(u) => u.cursor.event && tell("cursor", u.cursor.left >= 0 ? u.posToVal(u.cursor.left, "x") : null)],
      },
    }, [t, ...spec.curves.map((curve) => decode(curve.y))], holder);
    const canvas = chart.root.querySelector("canvas");
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", nameOf(holder) + ": " + spec.curves.filter((c) => c.edge !== "lower").map((c) => c.label).join(", "));
    holder.chart = chart;
    charts.push(chart);
  }

  // The cursor of every chart at one time, for the table of events.
  function pointAt(t) {
    for (const chart of charts) {
      const left = chart.valToPos(t, "x");
      const inside = left >= 0 && left <= chart.over.clientWidth;
      chart.setCursor({ left: inside ? left : -10, top: inside ? 10 : -10 }, false);
    }
    tell("cursor", t);
  }

  function phaseAt(t) {
    const phase = data.phases.find(([, from, to]) => t >= from && t < to);
    return phase ? phase[0] : "";
  }

  function nearestEvent(t) {
    const near = 0.006 * (whole[1] - whole[0]);
    let best = null;
    for (const event of data.events) {
      const away = Math.abs(event[0] - t);
      if (away < near && (best === null || away < Math.abs(best[0] - t))) best = event;
    }
    return best ? best[2] : "";
  }

  function start() {
    const specs = new Map(data.panels.map((spec) => [spec.key, spec]));
    for (const holder of document.querySelectorAll(".chart")) makeChart(holder, specs.get(holder.dataset.panel));
    if (charts.length) showWhole();
    body.dataset.rendered = charts.length + " charts";

    const readout = document.getElementById("readout");
    listeners.cursor.push((t) => {
      readout.textContent = t == null ? "" : [fixed(t, 2) + " s", phaseAt(t), nearestEvent(t)].filter(Boolean).join(" · ");
    });
    document.getElementById("whole").addEventListener("click", showWhole);
    for (const button of document.querySelectorAll("[data-phase]")) {
      button.querySelector("i").classList.toggle("shaded", shadedPhases.has(button.dataset.phase));
      button.addEventListener("click", () => zoom(Number(button.dataset.start), Number(button.dataset.end)));
    }
    for (const row of document.querySelectorAll("tr[data-time]")) {
      row.addEventListener("mouseenter", () => pointAt(Number(row.dataset.time)));
    }
  }

  const resize = (holder) => holder.chart && holder.clientWidth && holder.chart.setSize({ width: holder.clientWidth, height: heightOf(holder) });
  const redraw = () => {
    colours = {};
    charts.forEach((chart) => chart.redraw(false, true));
    tell("theme");
  };
  const relayout = () => {
    document.querySelectorAll(".chart").forEach(resize);
    redraw();
  };
  // On a narrow screen the parts begin folded: the headline, the figures and the path come first.
  const parts = document.querySelectorAll("details.part");
  for (const part of parts) part.addEventListener("toggle", () => part.open && relayout());
  if (window.matchMedia("(max-width: 600px)").matches) for (const part of parts) part.open = false;
  for (const link of document.querySelectorAll(".toolbar a")) {
    link.addEventListener("click", () => {
      const part = document.querySelector(link.getAttribute("href"));
      if (part instanceof HTMLDetailsElement) part.open = true;
    });
  }
  window.addEventListener("beforeprint", () => parts.forEach((part) => { part.open = true; }));
  window.addEventListener("resize", relayout);
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
  window.matchMedia("print").addEventListener("change", relayout);
  window.addEventListener("beforeprint", relayout);
  window.addEventListener("afterprint", relayout);

  return { data, decode, colour, fixed, listeners, start, report, FONT };
})();
flight.start();
