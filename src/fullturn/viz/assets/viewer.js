"use strict";
// A software point renderer: a depth buffer, round dots and a shade where a neighbor is nearer.
// It needs neither a graphics card nor a library, so the report opens everywhere.
(() => {
  const scene = JSON.parse(document.getElementById("scene").textContent);
  const canvas = document.getElementById("canvas");
  const stage = document.getElementById("stage");
  const context = canvas.getContext("2d", { alpha: false });
  const still = window.matchMedia("(prefers-reduced-motion: reduce)");
  const dark = window.matchMedia("(prefers-color-scheme: dark)");
  const EYE = 5; // distance of the eye from the center, in radii
  const BEHIND = -1e9;

  // --- data ---------------------------------------------------------------------------------
  const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  function points(block) {
    const raw = bytes(block.int16);
    const view = new DataView(raw.buffer);
    const out = new Float32Array(raw.length / 2);
    for (let i = 0; i < out.length; i++) out[i] = view.getInt16(2 * i, true) * block.step;
    return out;
  }
  const source = points(scene.source);
  const target = points(scene.target);
  const views = scene.views.map((v) => ({ ...v, q: quaternion(v.R) }));
  for (const v of views) if (v.near) v.near = { source: bytes(v.near.source), target: bytes(v.near.target) };
  const lines = { source: points(scene.matches.source), target: points(scene.matches.target), weight: bytes(scene.matches.weight) };

  // --- rotations ----------------------------------------------------------------------------
  function quaternion(m) {
    const [a, b, c, d, e, f, g, h, i] = m;
    // The largest component is found first: the usual trace formula breaks down near 180°.
    const s = [1 + a + e + i, 1 + a - e - i, 1 - a + e - i, 1 - a - e + i];
    const k = s.indexOf(Math.max(...s));
    const rows = [
      [s[0], h - f, c - g, d - b], [h - f, s[1], b + d, c + g],
      [c - g, b + d, s[2], f + h], [d - b, c + g, f + h, s[3]],
    ];
    return unit(rows[k]);
  }
  function unit(q) {
    const n = Math.hypot(...q);
    return q.map((x) => x / n);
  }
  function matrix([w, x, y, z]) {
    return [
      1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
      2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
      2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    ];
  }
  function product([a, b, c, d], [e, f, g, h]) {
    return unit([
      a * e - b * f - c * g - d * h, a * f + b * e + c * h - d * g,
      a * g - b * h + c * e + d * f, a * h + b * g - c * f + d * e,
    ]);
  }
  function slerp(p, q, s) {
    let dot = p.reduce((sum, x, i) => sum + x * q[i], 0);
    const to = dot < 0 ? q.map((x) => -x) : q;
    dot = Math.min(1, Math.abs(dot));
    const angle = Math.acos(dot);
    if (angle < 1e-3) return unit(p.map((x, i) => x + s * (to[i] - x)));
    return unit(p.map((x, i) => (Math.sin((1 - s) * angle) * x + Math.sin(s * angle) * to[i]) / Math.sin(angle)));
  }
  const turn = (axis, angle) => [Math.cos(angle / 2), ...axis.map((x) => x * Math.sin(angle / 2))];
  const mix = (a, b, s) => a + s * (b - a);
  function multiply(a, b) {
    const out = new Array(9);
    for (let r = 0; r < 3; r++)
      for (let c = 0; c < 3; c++)
        out[3 * r + c] = a[3 * r] * b[c] + a[3 * r + 1] * b[3 + c] + a[3 * r + 2] * b[6 + c];
    return out;
  }

  // --- colors -------------------------------------------------------------------------------
  let theme;
  function readTheme() {
    const style = getComputedStyle(document.documentElement);
    const color = (name) => {
      const hex = parseInt(style.getPropertyValue("--" + name).trim().slice(1), 16);
      return [hex >> 16, (hex >> 8) & 255, hex & 255];
    };
    const [near, mid, away] = [color("near"), color("mid"), color("away")];
    const ramp = new Uint8Array(3 * 256);
    for (let i = 0; i < 256; i++)
      for (let k = 0; k < 3; k++)
        ramp[3 * i + k] = i < 128 ? mix(near[k], mid[k], i / 127.5) : mix(mid[k], away[k], i / 127.5 - 1);
    theme = { stage: color("stage"), source: color("source"), target: color("target"), ramp };
  }

  // --- state --------------------------------------------------------------------------------
  const home = quaternion(scene.camera);
  const camera = { q: home, zoom: 1, x: 0, y: 0 };
  let now = { ...views[0] };
  let active = views[0];
  let byDistance = false;
  let width = 1, height = 1, depth = new Float32Array(1), image = null, pixels = null;

  function resize(scale) {
    const w = Math.max(1, Math.round(stage.clientWidth * scale));
    const h = Math.max(1, Math.round(stage.clientHeight * scale));
    if (image && w === width && h === height) return;
    width = canvas.width = w;
    height = canvas.height = h;
    depth = new Float32Array(w * h);
    image = context.createImageData(w, h);
    pixels = new Uint32Array(image.data.buffer);
  }
  const pack = (r, g, b) => (255 << 24) | (b << 16) | (g << 8) | r;

  // Pixels per radius, so that everything fits into the window at zoom 1.
  function fit(w, h) {
    return 0.5 * camera.zoom * Math.min(h / now.extent, w / (now.extent + now.gap));
  }

  // --- drawing ------------------------------------------------------------------------------
  function projector(R, t, shift) {
    const c = matrix(camera.q);
    const m = R ? multiply(c, R) : c;
    const o = [0, 3, 6].map((r) => c[r] * t[0] + c[r + 1] * t[1] + c[r + 2] * t[2]);
    const size = fit(width, height);
    const middle = [width / 2 + camera.x * size + shift * size, height / 2 - camera.y * size];
    return { m, o, size, middle };
  }
  function splat(xyz, { m, o, size, middle }, color, near) {
    const dot = Math.max(0.5, scene.dot * size);
    for (let i = 0; i < xyz.length; i += 3) {
      const x = xyz[i], y = xyz[i + 1], z = xyz[i + 2];
      const toward = m[6] * x + m[7] * y + m[8] * z + o[2];
      if (toward > EYE - 0.1) continue;
      const f = EYE / (EYE - toward);
      const u = middle[0] + size * f * (m[0] * x + m[1] * y + m[2] * z + o[0]);
      const v = middle[1] - size * f * (m[3] * x + m[4] * y + m[5] * z + o[1]);
      const radius = Math.min(24, dot * f), sq = radius * radius;
      const top = Math.max(0, Math.ceil(v - radius)), bottom = Math.min(height - 1, Math.floor(v + radius));
      if (near) { const k = 3 * near[i / 3]; color = pack(theme.ramp[k], theme.ramp[k + 1], theme.ramp[k + 2]); }
      for (let row = top; row <= bottom; row++) {
        const half = Math.sqrt(Math.max(0, sq - (row - v) * (row - v)));
        const left = Math.max(0, Math.ceil(u - half)), right = Math.min(width - 1, Math.floor(u + half));
        for (let p = row * width + left, end = row * width + right; p <= end; p++)
          if (toward > depth[p]) { depth[p] = toward; pixels[p] = color; }
      }
    }
  }
  // A pixel is darkened by how far its surroundings stand out in front of it; two distances show
  // both fine relief and whole parts.
  function shade(reach) {
    const border = 4 * reach;
    const step = [];
    for (const r of [reach, border]) step.push(-r, r, -r * width, r * width);
    for (let row = border; row < height - border; row++)
      for (let p = row * width + border, end = (row + 1) * width - border; p < end; p++) {
        const own = depth[p];
        if (own === BEHIND) continue;
        let hidden = 0;
        for (let k = 0; k < 8; k++) {
          const before = depth[p + step[k]] - own;
          if (before > 0) hidden += Math.min(before, 0.1);
        }
        const light = Math.exp(-2.6 * hidden) * (0.92 + 0.12 * Math.max(-1, Math.min(0.66, own)));
        const c = pixels[p];
        pixels[p] = pack((c & 255) * light, ((c >> 8) & 255) * light, ((c >> 16) & 255) * light);
      }
  }
  function draw(scale) {
    resize(scale);
    pixels.fill(pack(...theme.stage));
    depth.fill(BEHIND);
    const near = byDistance && active.near;
    const place = { source: projector(matrix(now.q), now.t, -now.gap), target: projector(null, scene.center, now.gap) };
    splat(source, place.source, pack(...theme.source), near && near.source);
    splat(target, place.target, pack(...theme.target), near && near.target);
    shade(Math.max(1, Math.round(scale)));
    context.putImageData(image, 0, 0);
    if (active.lines) drawLines(place, scale);
  }
  function drawLines(place, scale) {
    const at = ({ m, o, size, middle }, xyz, i) => {
      const x = xyz[i], y = xyz[i + 1], z = xyz[i + 2];
      const f = EYE / (EYE - (m[6] * x + m[7] * y + m[8] * z + o[2]));
      return [middle[0] + size * f * (m[0] * x + m[1] * y + m[2] * z + o[0]), middle[1] - size * f * (m[3] * x + m[4] * y + m[5] * z + o[1])];
    };
    context.lineWidth = 0.8 * scale;
    context.strokeStyle = `rgb(${theme.ramp.subarray(0, 3).join(",")})`;
    for (let i = 0; i < lines.weight.length; i++) {
      const a = at(place.source, lines.source, 3 * i), b = at(place.target, lines.target, 3 * i);
      context.globalAlpha = 0.12 + 0.45 * (lines.weight[i] / 255);
      context.beginPath();
      context.moveTo(...a);
      context.lineTo(...b);
      context.stroke();
    }
    context.globalAlpha = 1;
  }

  // While something moves, frames are cheap; once it rests, one frame is drawn at twice the
  // resolution, which the browser scales down: smooth edges.
  let queued = false, rest = 0;
  function refresh() {
    clearTimeout(rest);
    rest = setTimeout(() => draw(Math.max(2, window.devicePixelRatio)), 120);
    if (queued) return;
    queued = true;
    requestAnimationFrame(() => { queued = false; draw(1); });
  }

  // --- what is shown ------------------------------------------------------------------------
  let flight = 0;
  function show(view) {
    active = view;
    for (const b of document.querySelectorAll("[data-view]"))
      b.setAttribute("aria-pressed", String(views[+b.dataset.view] === view));
    document.getElementById("caption").textContent = view.caption;
    recolor(byDistance);
    cancelAnimationFrame(flight);
    const from = { ...now }, start = performance.now(), span = still.matches ? 1 : 700;
    const step = (time) => {
      const s = Math.min(1, Math.max(0, (time - start) / span)), e = s * s * (3 - 2 * s);
      now = {
        q: slerp(from.q, view.q, e), t: from.t.map((x, i) => mix(x, view.t[i], e)),
        gap: mix(from.gap, view.gap, e), extent: mix(from.extent, view.extent, e),
      };
      refresh();
      if (s < 1) flight = requestAnimationFrame(step);
    };
    step(start);
  }
  function recolor(on) {
    byDistance = on;
    const shown = on && Boolean(active.near);
    for (const b of document.querySelectorAll("[data-color]")) {
      b.setAttribute("aria-pressed", String((b.dataset.color === "distance") === shown));
      if (b.dataset.color === "distance") b.disabled = !active.near;
    }
    document.getElementById("legend-scan").hidden = shown;
    document.getElementById("legend-distance").hidden = !shown;
    refresh();
  }
  for (const b of document.querySelectorAll("[data-view]"))
    b.addEventListener("click", () => { show(views[+b.dataset.view]); if (b.closest("table")) stage.scrollIntoView({ block: "nearest" }); });
  for (const b of document.querySelectorAll("[data-color]"))
    b.addEventListener("click", () => recolor(b.dataset.color === "distance"));

  // --- mouse, touch, keys -------------------------------------------------------------------
  const fingers = new Map();
  const rotate = (dx, dy) => {
    camera.q = product(turn([0, 1, 0], dx), camera.q);
    camera.q = product(turn([1, 0, 0], dy), camera.q);
    refresh();
  };
  const zoom = (factor) => { camera.zoom = Math.min(40, Math.max(0.2, camera.zoom * factor)); refresh(); };
  const move = (dx, dy) => {
    const radius = fit(stage.clientWidth, stage.clientHeight);
    camera.x += dx / radius;
    camera.y -= dy / radius;
    refresh();
  };
  const reset = () => { Object.assign(camera, { q: home, zoom: 1, x: 0, y: 0 }); refresh(); };
  canvas.addEventListener("pointerdown", (e) => {
    canvas.setPointerCapture(e.pointerId);
    fingers.set(e.pointerId, [e.clientX, e.clientY]);
  });
  canvas.addEventListener("pointermove", (e) => {
    const last = fingers.get(e.pointerId);
    if (!last) return;
    const dx = e.clientX - last[0], dy = e.clientY - last[1];
    if (fingers.size === 2) {
      const [other] = [...fingers].filter(([id]) => id !== e.pointerId).map(([, at]) => at);
      const gap = (at) => Math.max(10, Math.hypot(at[0] - other[0], at[1] - other[1]));
      zoom(gap([e.clientX, e.clientY]) / gap(last));
      move(dx / 2, dy / 2);
    } else if (e.shiftKey || e.buttons & 6) move(dx, dy);
    else rotate(dx * 0.008, dy * 0.008);
    fingers.set(e.pointerId, [e.clientX, e.clientY]);
  });
  for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, (e) => fingers.delete(e.pointerId));
  canvas.addEventListener("contextmenu", (e) => e.preventDefault());
  canvas.addEventListener("dblclick", reset);
  canvas.addEventListener("wheel", (e) => { e.preventDefault(); zoom(Math.exp(-e.deltaY * (e.deltaMode ? 0.04 : 0.0015))); }, { passive: false });
  canvas.addEventListener("keydown", (e) => {
    const keys = {
      ArrowLeft: () => rotate(-0.1, 0), ArrowRight: () => rotate(0.1, 0),
      ArrowUp: () => rotate(0, -0.1), ArrowDown: () => rotate(0, 0.1),
      "+": () => zoom(1.15), "=": () => zoom(1.15), "-": () => zoom(1 / 1.15), 0: reset,
    };
    if (!(e.key in keys)) return;
    e.preventDefault();
    keys[e.key]();
  });

  document.getElementById("copy").addEventListener("click", async (e) => {
    const button = e.currentTarget, text = document.getElementById("matrix");
    getSelection().selectAllChildren(text); // still of use where copying is not allowed
    try { await navigator.clipboard.writeText(text.textContent); button.textContent = "Copied"; }
    catch { button.textContent = document.execCommand("copy") ? "Copied" : "Selected"; }
    setTimeout(() => { button.textContent = "Copy"; }, 1500);
  });

  readTheme();
  dark.addEventListener("change", () => { readTheme(); refresh(); });
  new ResizeObserver(refresh).observe(stage);
  // The address may name the view, as in report.html#view=0&color=distance.
  const wish = new URLSearchParams(location.hash.slice(1));
  const first = views[wish.get("view") ?? 1] ?? views[0];
  now = { ...first };
  byDistance = wish.get("color") === "distance";
  show(first);
})();
