// The curves of the plots: their values, how rough they are, and the band in which a chattering one lies.

/** Return what the drawing of a signal of a run needs; it is computed once. */
function curveOf(kind, run) {
  if (!run.curves.has(kind)) {
    const values = Array.from({ length: run.samples }, (_, k) => kind.signal(run, k));
    const low = values.reduce((a, b) => Math.min(a, b)), high = values.reduce((a, b) => Math.max(a, b));
    const rms = Math.sqrt(values.reduce((sum, value) => sum + value * value, 0) / values.length);
    const { roughness, turns } = roughnessOf(values, high - low);
    const curve = { values, low, high, rms, roughness, peak: Math.max(-low, high) };
    if (kind.range && run.range) { // over the seeds
      const [smallest, largest] = [0, 1].map((end) => values.map((_, k) => kind.range(run, 2 * k + end)));
      curve.range = { low: smallest, high: largest };
      curve.peak = largest.reduce((a, b) => Math.max(a, b));
    }
    if (roughness > CHATTER && !kind.log) curve.band = bandOf(values, Math.ceil((5 * values.length) / turns));
    run.curves.set(kind, curve);
  }
  return run.curves.get(kind);
}

/**
 * Return how many times a curve traverses its range, and how often it turns.
 *
 * Turns of less than a fiftieth of the range do not count. A smooth curve of the paper's motion has a roughness below
 * ten, a torque that alternates between samples has hundreds.
 */
function roughnessOf(values, range) {
  const least = range / 50;
  let [from, extreme, direction, turns, travelled] = [values[0], values[0], 0, 0, 0];
  for (const value of values) {
    if (direction * (value - extreme) > 0) extreme = value;
    else if (Math.abs(value - extreme) > least) {
      if (direction) turns += 1;
      travelled += Math.abs(extreme - from);
      from = extreme;
      direction = Math.sign(value - extreme);
      extreme = value;
    }
  }
  travelled += Math.abs(extreme - from);
  return { roughness: range ? travelled / range : 0, turns };
}

/** Return minimum, maximum and mean of the values in a window of this many samples around each sample. */
function bandOf(values, samples) {
  const half = Math.ceil(samples / 2), band = { low: [], high: [], mean: [], samples: 2 * half + 1 };
  values.forEach((_, k) => {
    const near = values.slice(Math.max(0, k - half), k + half + 1);
    band.low.push(Math.min(...near));
    band.high.push(Math.max(...near));
    band.mean.push(near.reduce((sum, value) => sum + value, 0) / near.length);
  });
  return band;
}

/** Return a value with three digits, a large one with one decimal place, a tiny one as a power of ten. */
function valueText(value) {
  const size = Math.abs(value);
  if (size === 0) return "0";
  let text = size >= 100 ? value.toFixed(size >= 1000 ? 0 : 1) : value.toPrecision(3);
  if (size < 1e-3) {
    const [digits, exponent] = value.toExponential(1).split("e");
    text = `${digits}·${superscript(Number(exponent))}`;
  }
  return text.replace("-", "−");
}
