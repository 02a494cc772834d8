"use strict";
// A software renderer with a depth buffer: it needs neither a graphics card nor a library.
(() => {
  const scene = JSON.parse(document.getElementById("scene").textContent);
  const canvas = document.getElementById("canvas");
  const stage = document.getElementById("stage");
  const context = canvas.getContext("2d", { alpha: false });
  const boxes = [...document.querySelectorAll("input[data-scan]")];
  const scans = scene.scans.map((scan) => {
    const raw = Uint8Array.from(atob(scan.int16), (c) => c.charCodeAt(0));
    const view = new DataView(raw.buffer);
    const at = new Float32Array(raw.length / 2);
    for (let i = 0; i < at.length; i++) at[i] = view.getInt16(2 * i, true) * scan.step;
    return { at, color: scan.color };
  });
  let R = scene.camera.slice(), zoom = 1, asked = false;

  function turn(x, y) {
    const [c, s] = [Math.cos(x), Math.sin(x)], [d, t] = [Math.cos(y), Math.sin(y)];
    const Q = [c, 0, s, t * s, d, -t * c, -d * s, t, d * c], out = [];
    for (let i = 0; i < 3; i++) for (let j = 0; j < 3; j++)
      out.push(Q[3 * i] * R[j] + Q[3 * i + 1] * R[3 + j] + Q[3 * i + 2] * R[6 + j]);
    R = out;
  }
  function draw() {
    asked = false;
    const ratio = Math.min(window.devicePixelRatio || 1, 2);
    const w = canvas.width = Math.max(1, Math.round(stage.clientWidth * ratio));
    const h = canvas.height = Math.max(1, Math.round(stage.clientHeight * ratio));
    const image = context.createImageData(w, h), depth = new Float32Array(w * h).fill(-1e9);
    const back = getComputedStyle(stage).backgroundColor.match(/[\d.]+/g).map(Number);
    const pixels = image.data;
    for (let i = 0; i < w * h; i++) {
      pixels.set([back[0], back[1], back[2], 255], 4 * i);
    }
    const unit = 0.45 * Math.min(w, h) * zoom, dot = Math.max(1, Math.round(scene.dot * unit));
    scans.forEach(({ at, color }, number) => {
      if (!boxes[number].checked) return;
      for (let i = 0; i < at.length; i += 3) {
        const [x, y, z] = [at[i], at[i + 1], at[i + 2]];
        const u = Math.round(w / 2 + unit * (R[0] * x + R[1] * y + R[2] * z));
        const v = Math.round(h / 2 - unit * (R[3] * x + R[4] * y + R[5] * z));
        const near = R[6] * x + R[7] * y + R[8] * z;
        const shade = 0.7 + 0.3 * Math.max(-1, Math.min(1, near));
        for (let b = v - dot; b < v + dot; b++) for (let a = u - dot; a < u + dot; a++) {
          if (a < 0 || b < 0 || a >= w || b >= h || depth[b * w + a] >= near) continue;
          depth[b * w + a] = near;
          for (let k = 0; k < 3; k++) pixels[4 * (b * w + a) + k] = shade * color[k];
        }
      }
    });
    context.putImageData(image, 0, 0);
  }
  const redraw = () => { if (!asked) { asked = true; requestAnimationFrame(draw); } };

  let last = null;
  canvas.addEventListener("pointerdown", (e) => { last = [e.clientX, e.clientY]; canvas.setPointerCapture(e.pointerId); });
  canvas.addEventListener("pointerup", () => { last = null; });
  canvas.addEventListener("pointermove", (e) => {
    if (!last) return;
    turn((e.clientX - last[0]) * 0.008, (e.clientY - last[1]) * 0.008);
    last = [e.clientX, e.clientY];
    redraw();
  });
  canvas.addEventListener("wheel", (e) => { e.preventDefault(); zoom *= Math.exp(-e.deltaY * 0.001); redraw(); }, { passive: false });
  canvas.addEventListener("dblclick", () => { R = scene.camera.slice(); zoom = 1; redraw(); });
  canvas.addEventListener("keydown", (e) => {
    const by = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, -0.1], ArrowDown: [0, 0.1] }[e.key];
    if (by) turn(...by);
    else if (e.key === "+") zoom *= 1.1;
    else if (e.key === "-") zoom /= 1.1;
    else return;
    e.preventDefault();
    redraw();
  });
  for (const box of boxes) box.addEventListener("change", redraw);
  for (const button of document.querySelectorAll("button[data-group]")) button.addEventListener("click", () => {
    for (const box of boxes) box.checked = !box.disabled && box.dataset.group === button.dataset.group;
    redraw();
  });
  new ResizeObserver(redraw).observe(stage);
  redraw();
})();
