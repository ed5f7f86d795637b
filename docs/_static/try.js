"use strict";
// The page docs/try.md: two laws on the arm of arm.js, run for a whole episode at once and then replayed.
(async () => {
  const PERIOD = 1e-3, STEPS = 1500, MAGNIFIED = 25, FIRST = 0.5;
  const NAMES = ["fuzzy-4-tip", "elastic-observer"], COLOURS = ["#0072b2", "#d55e00"];
  const byId = (id) => document.getElementById(id);
  const bytes = Uint8Array.from(atob(ARM), (letter) => letter.charCodeAt(0));
  const { instance } = await WebAssembly.instantiate(bytes, {});
  const { start, step, shown, memory } = instance.exports;
  const numbers = new Float64Array(memory.buffer, shown.value, 10);

  // An episode: the shown numbers of every step, and the errors [mm].
  function run(law, payload, share) {
    const rows = [], errors = [];
    start(law, payload);
    for (let k = 0; k < STEPS; k++) {
      errors.push(1e3 * step(share));
      rows.push(Float64Array.from(numbers));
    }
    const rms = Math.sqrt(errors.reduce((sum, one) => sum + one * one, 0) / STEPS);
    return { rows, errors, rms, largest: Math.max(...errors) };
  }

  const text = (value) => (value < 1e-3 ? "< 0.001" : value.toPrecision(3));

  function draw(canvas, episode, colour, at) {
    const side = canvas.width, scale = 0.85 * side, c = canvas.getContext("2d");
    // x of the paper points down, y to the right; the canvas is 1.18 m wide, the base near its upper left corner.
    const place = (x, y) => [0.15 * side + scale * y, 0.1 * side + scale * x];
    const line = (points, style, width) => {
      c.beginPath();
      points.forEach(([x, y], k) => (k ? c.lineTo(x, y) : c.moveTo(x, y)));
      Object.assign(c, { strokeStyle: style, lineWidth: width, lineJoin: "round", lineCap: "round" });
      c.stroke();
    };
    const ink = getComputedStyle(canvas).color;
    c.clearRect(0, 0, side, canvas.height);
    line(episode.rows.map((row) => place(row[6], row[7])), "#999999", 1.5);
    const magnified = (row) => place(...[0, 1].map((k) => row[6 + k] + MAGNIFIED * (row[4 + k] - row[6 + k])));
    line(episode.rows.slice(0, at + 1).map(magnified), colour, 2.5);
    const row = episode.rows[at], elbow = [FIRST * Math.cos(row[0]), FIRST * Math.sin(row[0])];
    line([place(0, 0), place(...elbow), place(row[4], row[5])], ink, 5);
  }

  let episodes = [], at = 0, running = false;
  function show() {
    episodes.forEach((one, law) => draw(byId(`arm-${law}`), one, COLOURS[law], at));
    byId("arm-time").textContent = `${((at + 1) * PERIOD).toFixed(2)} s`;
  }
  function compute() {
    const payload = Number(byId("arm-payload").value), share = Number(byId("arm-force").value);
    byId("arm-payload-value").textContent = `${payload.toFixed(1)} kg`;
    byId("arm-force-value").textContent = `${share.toFixed(2)} times Case 2`;
    episodes = NAMES.map((_, law) => run(law, payload, share));
    episodes.forEach((one, law) => {
      byId(`arm-rms-${law}`).textContent = text(one.rms);
      byId(`arm-largest-${law}`).textContent = text(one.largest);
    });
    show();
  }
  function tick() {
    if (!running) return;
    at = (at + 8) % STEPS;
    show();
    requestAnimationFrame(tick);
  }
  byId("arm-play").addEventListener("click", () => {
    running = !running;
    byId("arm-play").textContent = running ? "Stop" : "Play";
    tick();
  });
  for (const id of ["arm-payload", "arm-force"]) byId(id).addEventListener("input", compute);
  at = STEPS - 1;
  compute();
  document.body.dataset.arm = "ready";
})();
