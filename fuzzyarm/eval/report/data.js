"use strict";
// The replay: arms and curves of the embedded rollouts. The frame is the robot's: x points down, y to the right.

const BENDING = 20; // the arm as its motors stand is drawn with the joints' bending this many times larger
const MAGNIFICATIONS = [1, 2, 5, 10, 25, 50, 100, 250, 1000, 10000];
const ROOM = 0.12; // [m] around the reference, for magnified deviations
// An axis with focus leaves out curves whose peak is beyond FOCUS times the best one's, or SMALL's [mm, mrad].
const FOCUS = 5, SMALL = 2;
const LOWEST = 1e-4; // [mm] of a logarithmic axis, below the error of the simulation
const DASHES = [[], [7, 3], [2, 2.5], [9, 3, 2, 3], [14, 4], [4, 4], [5, 2, 2, 2, 2, 2], [14, 3, 5, 3], [2, 6]];
const STEP = 0.25; // [s] between pictures for readers who prefer reduced motion

const largest = (values) => values.reduce((most, value) => Math.max(most, Math.abs(value)), 0);
const rootMeanSquare = (values) => Math.sqrt(values.reduce((sum, value) => sum + value * value, 0) / values.length);
const $ = (id) => document.getElementById(id);
const reducedMotion = matchMedia("(prefers-reduced-motion: reduce)");
const systemDark = matchMedia("(prefers-color-scheme: dark)");

/** Little-endian float32 in base64 to numbers. */
function floats(text) {
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  return new Float32Array(bytes.buffer);
}

function decodedRun(run) {
  const decoded = { ended: run.ended };
  for (const name of ["deviation", "link", "bending", "torque", "circularity"]) decoded[name] = floats(run[name]);
  decoded.samples = decoded.circularity.length;
  decoded.error = decoded.circularity.map((_, k) => Math.hypot(decoded.deviation[2 * k], decoded.deviation[2 * k + 1]));
  decoded.peak = largest(decoded.error);
  return decoded;
}

const report = JSON.parse($("data").textContent);
for (const scene of report.cases) {
  scene.time = floats(scene.time);
  scene.reference = floats(scene.reference);
  scene.force = scene.force && floats(scene.force);
  scene.strongest = scene.force && largest(scene.force);
  scene.runs = scene.runs.map(decodedRun);
}

const state = { scene: report.cases[0], sample: 0, clock: 0, playing: false, chosen: new Set(), highlighted: null };
report.policies.forEach((_, policy) => state.chosen.add(policy));

const chosen = () => report.policies.map((_, policy) => policy).filter((policy) => state.chosen.has(policy));
/** The sample of a run at the present instant; a run that ended early stays at its last. */
const sampleOf = (run) => Math.min(state.sample, run.samples - 1);
