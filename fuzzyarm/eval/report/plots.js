// The curves over time, with a cursor at the current instant.

const torque = (joint) =>
  ({ title: `Motor torque, joint ${joint + 1}`, unit: "N m", signal: (run, k) => run.torque[JOINTS * k + joint] });
const bending = (joint) => ({
  title: `Bending, joint ${joint + 1}`, unit: "mrad", focus: true,
  signal: (run, k) => 1e3 * run.bending[JOINTS * k + joint],
});
const each = Array.from({ length: JOINTS }, (_, joint) => joint);
const PLOTS = [
  {
    title: "Tip error", unit: "mm", log: true, signal: (run, k) => 1e3 * run.error[k],
    range: (run, index) => 1e3 * run.range[index],
  },
  { title: "Tip circularity", unit: "mm", focus: true, signal: (run, k) => 1e3 * run.circularity[k] },
  // Two joints side by side; of more, a row for each joint.
  ...(JOINTS === 2 ? [...each.map(torque), ...each.map(bending)] : each.flatMap((k) => [torque(k), bending(k)])),
];
const EDGE = { left: 44, right: 8, top: 8, bottom: 20 }; // [px]
const CURSOR = 7; // [px] to each side of a cursor that is drawn again when it moves

/** Return about `count` round numbers from low to high. */
function ticks(low, high, count) {
  const raw = (high - low) / count, unit = 10 ** Math.floor(Math.log10(raw));
  const step = unit * [1, 2, 2.5, 5, 10].find((factor) => factor * unit >= raw * (1 - 1e-9));
  const found = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k += 1) found.push(k * step);
  return found;
}

const superscript = (exponent) =>
  `10${String(exponent).replace(/./g, (sign) => "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"["-0123456789".indexOf(sign)])}`;
const label = (value, log) => {
  if (!log) return String(Number(value.toPrecision(6))).replace("-", "−");
  const exponent = Math.round(Math.log10(value));
  return exponent >= -2 && exponent <= 2 ? String(Number((10 ** exponent).toPrecision(1))) : superscript(exponent);
};

/** A plot of the chosen policies over time, with cursors and the values at them. The curves are drawn once. */
class Plot {
  constructor(kind) {
    this.kind = kind;
    this.canvas = element("canvas");
    this.canvas.setAttribute("role", "img");
    this.remark = element("span", { className: "remark" }); // on curves that leave the axis or are drawn as bands
    const caption = element("figcaption", {}, element("span", { textContent: `${kind.title} [${kind.unit}]` }), this.remark);
    this.time = changingText("li", { className: "instant" });
    this.readouts = report.policies.map((name, policy) => {
      const text = changingText("span"), swatch = element("i", { className: `swatch ${colourClass(policy)}` });
      return { ...text, row: element("li", { title: name }, swatch, text.made) };
    });
    const values = element("ul", { className: "values" }, this.time.made, ...this.readouts.map(({ row }) => row));
    values.setAttribute("aria-label", `${kind.title} at the cursor`);
    this.figure = element("figure", {}, caption, element("div", { className: "plot" }, this.canvas, values));
    this.drawn = []; // places [px] of the cursors that are drawn
    this.canvas.addEventListener("pointerdown", (event) => {
      this.canvas.setPointerCapture(event.pointerId);
      goTo(this.sampleAt(event));
    });
    this.canvas.addEventListener("pointermove", (event) => {
      if (event.buttons) goTo(this.sampleAt(event));
      else if (event.pointerType === "mouse") pointAt(this.sampleAt(event));
    });
    this.canvas.addEventListener("pointerleave", () => pointAt(null));
  }

  /** Return the sample below the pointer. */
  sampleAt(event) {
    const share = (event.offsetX - EDGE.left) / (this.canvas.box.width - EDGE.left - EDGE.right);
    return nearest(share * state.scene.time.at(-1));
  }

  curve(policy) {
    return curveOf(this.kind, state.scene.runs[policy]);
  }

  /** Return the ends of the vertical axis for these curves. */
  measure(curves) {
    const limit = this.kind.focus ? FOCUS * Math.max(SMALL, Math.min(...curves.map(({ peak }) => peak))) : Infinity;
    if (this.kind.log) {
      const typical = Math.min(...curves.map(({ rms }) => rms));
      const low = Math.floor(Math.log10(Math.max(LOWEST, 0.1 * typical)));
      const high = Math.ceil(Math.log10(Math.max(...curves.map(({ peak }) => peak), LOWEST)));
      return [10 ** low, 10 ** Math.max(low + 1, high)];
    }
    const within = curves.filter(({ peak }) => peak <= limit);
    const low = Math.min(0, ...within.map((curve) => curve.low)), high = Math.max(0, ...within.map((curve) => curve.high));
    const margin = 0.06 * (high - low) || 1;
    return [low - (low < 0 ? margin : 0), high + (high > 0 || low === 0 ? margin : 0)];
  }

  x(time) {
    return EDGE.left + (time / state.scene.time.at(-1)) * (this.canvas.box.width - EDGE.left - EDGE.right);
  }

  y(value) {
    const place = (v) => (this.kind.log ? Math.log10(Math.max(v, 1e-30)) : v);
    const share = (place(value) - place(this.low)) / (place(this.high) - place(this.low));
    const bottom = this.canvas.box.height - EDGE.bottom;
    return bottom - Math.max(-5, Math.min(5, share)) * (bottom - EDGE.top);
  }

  /** Return whether a policy is drawn as a band: it chatters, and there are others that it would bury. */
  banded(policy) {
    return Boolean(this.curve(policy).band) && state.chosen.size > 1 && state.highlighted !== policy;
  }

  /** Return the chosen policies in the order of drawing: bands, rough curves, smooth ones, and the highlighted one. */
  order() {
    const rank = (policy) => {
      if (state.highlighted === policy) return -1;
      return this.banded(policy) ? Infinity : this.curve(policy).roughness;
    };
    return chosen().sort((a, b) => rank(b) - rank(a) || a - b);
  }

  /** Draw axes and curves, and keep them in a hidden canvas from which `draw` copies them. */
  prepare() {
    const { kind } = this, { width, height } = this.canvas.box, policies = chosen();
    this.still = stillOf(this.canvas);
    const context = cleared(this.still);
    [this.low, this.high] = policies.length ? this.measure(policies.map((p) => this.curve(p))) : [kind.log ? 0.1 : -1, 1];
    this.drawAxes(context, width, height);
    context.save();
    context.beginPath();
    context.rect(EDGE.left, EDGE.top - 2, width - EDGE.left - EDGE.right + 2, height - EDGE.top - EDGE.bottom + 4);
    context.clip();
    const shadeOf = (policy) => (state.highlighted === null || state.highlighted === policy ? 1 : 0.15);
    for (const policy of this.order().filter((one) => this.curve(one).range)) {
      const { range } = this.curve(policy);
      context.globalAlpha = 0.25 * shadeOf(policy);
      polygon(context, [...this.points(range.low), ...this.points(range.high).reverse()], colourOf(policy));
    }
    for (const policy of this.order()) {
      const { values, band } = this.curve(policy), colour = colourOf(policy), shade = shadeOf(policy);
      context.lineCap = "butt";
      if (this.banded(policy)) {
        context.globalAlpha = 0.22 * shade;
        polygon(context, [...this.points(band.low), ...this.points(band.high).reverse()], colour);
      }
      context.globalAlpha = shade;
      const line = this.points(this.banded(policy) ? band.mean : values);
      stroke(context, line, colour, 1.8, dashesOf(policy));
      if (state.scene.runs[policy].ended) this.cross(context, this.points(values).at(-1), colour);
    }
    context.restore();
    this.describe(policies);
    this.drawn = null;
  }

  /** Return the places [px] of values at the samples; a value below a logarithmic axis is drawn at its end. */
  points(values) {
    const floor = this.kind.log ? this.low : -Infinity;
    return values.map((value, k) => [this.x(state.scene.time[k]), this.y(Math.max(value, floor))]);
  }

  drawAxes(context, width, height) {
    const bottom = height - EDGE.bottom;
    context.font = font(12);
    context.textBaseline = "middle";
    context.textAlign = "right";
    const decades = Math.round(Math.log10(this.high / this.low));
    const levels = this.kind.log
      ? Array.from({ length: decades + 1 }, (_, k) => this.low * 10 ** k).filter((_, k) => decades < 6 || k % 2 === 0)
      : ticks(this.low, this.high, height < 160 ? 4 : 5);
    for (const level of levels) {
      const zero = !this.kind.log && Math.abs(level) < 1e-12;
      const line = [[EDGE.left, this.y(level)], [width - EDGE.right, this.y(level)]];
      stroke(context, line, zero ? colours.reference : colours.line, 1);
      context.fillStyle = colours.soft;
      context.fillText(label(level, this.kind.log), EDGE.left - 6, this.y(level));
    }
    const last = state.scene.time.at(-1), times = ticks(0, last, width < 420 ? 3 : 6);
    times.forEach((time, index) => {
      const text = index === times.length - 1 ? `${label(time)} s` : label(time);
      stroke(context, [[this.x(time), bottom], [this.x(time), bottom + 4]], colours.soft, 1);
      context.textAlign = "center";
      context.fillText(text, Math.min(this.x(time), width - 0.5 * context.measureText(text).width), bottom + 12);
    });
  }

  /** Mark the early end of an episode. */
  cross(context, [right, down], colour) {
    stroke(context, [[right - 5, down - 5], [right + 5, down + 5]], colour, 2.5);
    stroke(context, [[right - 5, down + 5], [right + 5, down - 5]], colour, 2.5);
  }

  describe(policies) {
    const name = (policy) => report.policies[policy], all = policies.map(name).join(", ") || "no policy chosen";
    const outside = policies.filter((policy) => this.curve(policy).peak > Math.max(this.high, -this.low));
    const bands = policies.filter((policy) => this.curve(policy).band && policies.length > 1);
    const remarks = [];
    if (outside.length) remarks.push(["off the axis", outside]);
    if (bands.length) remarks.push(["band", bands]);
    this.remark.textContent = remarks.map(([what, some]) => `${what}: ${some.length} of ${policies.length}`).join("; ");
    this.remark.title = remarks.map(([what, some]) => `${what}: ${some.map(name).join(", ")}`).join("; ");
    const { title, unit } = this.kind;
    this.canvas.setAttribute("aria-label", `${title} in ${unit} over time, ${state.scene.title}: ${all}`);
    this.readouts.forEach(({ row }, policy) => { row.hidden = !state.chosen.has(policy); });
  }

  /** Draw the cursors; only the strips around them change. */
  draw() {
    const { ratio, width, height } = this.canvas.box;
    if (!width || !height) return;
    const context = this.canvas.getContext("2d"), whole = [0, this.canvas.width];
    context.setTransform(1, 0, 0, 1, 0, 0);
    const strips = this.drawn?.map((x) => [Math.floor((x - CURSOR) * ratio), Math.ceil(2 * CURSOR * ratio)]) ?? [whole];
    for (const [left, wide] of strips) {
      context.clearRect(left, 0, wide, this.canvas.height);
      context.drawImage(this.still, left, 0, wide, this.canvas.height, left, 0, wide, this.canvas.height);
    }
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    this.drawn = [this.cursor(context, state.sample, colours.ink)];
    if (state.pointed !== null) this.drawn.push(this.cursor(context, state.pointed, colours.soft, [3, 3]));
  }

  /** Draw a cursor at a sample, with a disc on each curve, and return its place [px]. */
  cursor(context, sample, colour, dashes) {
    const x = this.x(state.scene.time[sample]);
    stroke(context, [[x, EDGE.top], [x, this.canvas.box.height - EDGE.bottom]], colour, 1.2, dashes);
    for (const policy of this.order()) {
      const value = this.curve(policy).values[sample];
      if (value === undefined || value > this.high || (value < this.low && !this.kind.log)) continue;
      const place = [x, this.y(Math.max(value, this.kind.log ? this.low : value))];
      disc(context, place, 4.5, colours.paper);
      disc(context, place, 3.2, colourOf(policy));
    }
    return x;
  }

  /** Write the values at the pointer, or else at the current instant. */
  write() {
    const sample = state.pointed ?? state.sample;
    this.time.set(timeText(sample));
    for (const policy of chosen()) {
      const value = this.curve(policy).values[sample];
      this.readouts[policy].set(value === undefined ? "ended" : valueText(value));
    }
  }
}
