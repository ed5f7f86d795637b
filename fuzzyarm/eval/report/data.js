"use strict";
// The data of the replay: the embedded rollouts, and what the reader has chosen.
// Positions are in the frame of the robot; of the two-joint arm, x points down, y to the right.

const PALETTE = 16; // number of policy colours in page.css
const BENDING = 20; // magnification of the joints' bending in the arm that is drawn at its motor angles
const MAGNIFICATIONS = [1, 2, 5, 10, 25, 50, 100, 250, 1000, 10000];
// An axis with focus is not scaled to curves whose peak exceeds FOCUS times the smallest peak, or FOCUS times SMALL
// [mm, mrad] if that is larger.
const FOCUS = 5, SMALL = 2;
const LOWEST = 1e-4; // [mm], lower end of a logarithmic axis; smaller than the error of the simulation
const DASHES = [[], [7, 3], [2, 2.5], [9, 3, 2, 3], [14, 4], [4, 4], [5, 2, 2, 2, 2, 2], [14, 3, 5, 3], [2, 6]];
const CHATTER = 25; // a curve that traverses its range more often is drawn as a band
const STEP = 0.25; // [s] between two pictures for readers who prefer reduced motion

const largest = (values) => values.reduce((most, value) => Math.max(most, Math.abs(value)), 0);
const rootMeanSquare = (values) => Math.sqrt(values.reduce((sum, value) => sum + value * value, 0) / values.length);
const $ = (id) => document.getElementById(id);
const reducedMotion = matchMedia("(prefers-reduced-motion: reduce)");
const systemDark = matchMedia("(prefers-color-scheme: dark)");

const report = JSON.parse($("data").textContent);
const JOINTS = report.robot?.joints.length ?? 2, AXES = report.robot ? 3 : 2;
const ROOM = 0.12 * (report.robot?.reach ?? 1); // [m] around the reference, for magnified deviations

/** The numbers of a sample, of all joints or coordinates, in an array that holds them one after the other. */
const rowAt = (values, sample, size) => Array.from(values.subarray(size * sample, size * (sample + 1)));
const jointsAt = (values, sample) => rowAt(values, sample, JOINTS);
const placeAt = (values, sample) => rowAt(values, sample, AXES);
const colourClass = (policy) => `p${policy % PALETTE}`;

/** Decode little-endian float32 numbers in base64. */
function floats(text) {
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  return new Float32Array(bytes.buffer);
}

function decodedRun(run) {
  const decoded = { ended: run.ended };
  for (const name of ["deviation", "link", "bending", "torque", "circularity"]) decoded[name] = floats(run[name]);
  decoded.range = run.range && floats(run.range); // smallest and largest tip error of any seed [m]
  decoded.samples = decoded.circularity.length;
  decoded.error = Array.from(decoded.circularity, (_, k) => Math.hypot(...placeAt(decoded.deviation, k)));
  decoded.worst = decoded.error.indexOf(Math.max(...decoded.error));
  decoded.peak = decoded.error[decoded.worst];
  decoded.curves = new Map();
  return decoded;
}

for (const scene of report.cases) {
  scene.time = floats(scene.time);
  scene.reference = floats(scene.reference);
  scene.force = scene.force && floats(scene.force);
  scene.strongest = scene.force && largest(scene.force);
  scene.runs = scene.runs.map(decodedRun);
}

/** The case that tells the policies apart: the one in which the best policy errs most. */
const smallestPeak = ({ runs }) => Math.min(...runs.map(({ ended, peak }) => (ended ? Infinity : peak)));
const hardest = report.cases.reduce((hard, scene) => (smallestPeak(scene) > smallestPeak(hard) ? scene : hard));

/** `sample` is the current instant, `pointed` the one below the pointer in a plot, null if there is none. */
const state = {
  scene: hardest, sample: 0, clock: 0, pointed: null, playing: false, chosen: new Set(), highlighted: null,
};
report.policies.forEach((name, policy) => report.ticked.includes(name) && state.chosen.add(policy));

const chosen = () => report.policies.map((_, policy) => policy).filter((policy) => state.chosen.has(policy));
/** The sample of a run at the current instant; a run that ended early stays at its last sample. */
const sampleOf = (run) => Math.min(state.sample, run.samples - 1);
/** Return the chosen policy with the largest tip error in the current case, null if none is chosen. */
function worstPolicy() {
  const { runs } = state.scene;
  return chosen().reduce((worst, policy) => (runs[policy].peak > (runs[worst]?.peak ?? -1) ? policy : worst), null);
}

/** Return the sample with the largest tip error of any chosen policy. */
const worstSample = () => state.scene.runs[worstPolicy()]?.worst ?? 0;
