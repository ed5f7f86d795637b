// The curves over time, with a cursor at the current instant.

const torque = (joint) => (run, k) => pairAt(run.torque, k)[joint];
const bending = (joint) => (run, k) => 1e3 * pairAt(run.bending, k)[joint];
const PLOTS = [
  { title: "Tip error", unit: "mm", log: true, signal: (run, k) => 1e3 * run.error[k] },
  { title: "Circularity error of the tip", unit: "mm", focus: true, signal: (run, k) => 1e3 * run.circularity[k] },
  { title: "Motor torque, joint 1", unit: "N m", signal: torque(0) },
  { title: "Motor torque, joint 2", unit: "N m", signal: torque(1) },
  { title: "Bending of joint 1, motor less link", unit: "mrad", focus: true, signal: bending(0) },
  { title: "Bending of joint 2, motor less link", unit: "mrad", focus: true, signal: bending(1) },
];
const EDGE = { left: 54, right: 10, top: 8, bottom: 34 }; // [px]

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

/** A plot of the chosen policies over time; the curves are drawn once and copied, and the cursor is drawn each time. */
class Plot {
  constructor(kind) {
    this.kind = kind;
    this.canvas = element("canvas");
    this.canvas.setAttribute("role", "img");
    this.curves = element("canvas");
    this.outside = element("span", { className: "outside" }); // names of policies whose curves leave the axis
    const caption = element("figcaption", {}, `${kind.title} [${kind.unit}]`, this.outside);
    this.figure = element("figure", {}, caption, this.canvas);
    this.canvas.addEventListener("pointerdown", (event) => {
      this.canvas.setPointerCapture(event.pointerId);
      this.seek(event);
    });
    this.canvas.addEventListener("pointermove", (event) => event.buttons && this.seek(event));
  }

  /** Move the replay to the time under the pointer. */
  seek(event) {
    const share = (event.offsetX - EDGE.left) / (this.canvas.clientWidth - EDGE.left - EDGE.right);
    goTo(nearest(share * state.scene.time.at(-1)));
  }

  /** Return the values of a policy's curve. */
  values(policy) {
    const run = state.scene.runs[policy];
    return Array.from({ length: run.samples }, (_, k) => this.kind.signal(run, k));
  }

  /** Return the ends of the vertical axis for these curves. */
  measure(curves) {
    const peaks = curves.map((values) => largest(values));
    const limit = this.kind.focus ? FOCUS * Math.max(SMALL, Math.min(...peaks)) : Infinity;
    const within = curves.filter((_, index) => peaks[index] <= limit);
    if (this.kind.log) {
      const typical = Math.min(...curves.map(rootMeanSquare));
      const low = Math.floor(Math.log10(Math.max(LOWEST, 0.1 * typical)));
      return [10 ** low, 10 ** Math.max(low + 1, Math.ceil(Math.log10(Math.max(...peaks, LOWEST))))];
    }
    const low = within.flat().reduce((a, b) => Math.min(a, b), 0);
    const high = within.flat().reduce((a, b) => Math.max(a, b), 0);
    const margin = 0.06 * (high - low) || 1;
    return [low - (low < 0 ? margin : 0), high + (high > 0 || low === 0 ? margin : 0)];
  }

  x(time) {
    return EDGE.left + (time / state.scene.time.at(-1)) * (this.canvas.clientWidth - EDGE.left - EDGE.right);
  }

  y(value) {
    const place = (v) => (this.kind.log ? Math.log10(Math.max(v, 1e-30)) : v);
    const share = (place(value) - place(this.low)) / (place(this.high) - place(this.low));
    const bottom = this.canvas.clientHeight - EDGE.bottom;
    return bottom - Math.max(-5, Math.min(5, share)) * (bottom - EDGE.top);
  }

  /** Draw axes and curves, and keep them in a hidden canvas from which `draw` copies them. */
  prepare() {
    const { canvas, curves, kind } = this, policies = chosen();
    [curves.width, curves.height] = [0, 0];
    const context = fitted(canvas), [width, height] = [canvas.clientWidth, canvas.clientHeight];
    const values = policies.map((policy) => this.values(policy));
    [this.low, this.high] = policies.length ? this.measure(values) : [kind.log ? 0.1 : -1, 1];
    this.drawAxes(context, width, height);
    context.save();
    context.beginPath();
    context.rect(EDGE.left, EDGE.top - 2, width - EDGE.left - EDGE.right + 2, height - EDGE.top - EDGE.bottom + 4);
    context.clip();
    policies.forEach((policy, index) => {
      context.globalAlpha = state.highlighted === null || state.highlighted === policy ? 1 : 0.15;
      const floor = kind.log ? this.low : -Infinity;
      const points = values[index].map((value, k) => [this.x(state.scene.time[k]), this.y(Math.max(value, floor))]);
      context.lineCap = "butt";
      stroke(context, points, colourOf(policy), 2, dashesOf(policy));
      if (state.scene.runs[policy].ended) this.cross(context, points.at(-1), colourOf(policy));
    });
    context.restore();
    const outside = policies.filter((_, index) => largest(values[index]) > Math.max(this.high, -this.low));
    const names = outside.map((policy) => report.policies[policy]).join(", ");
    this.outside.textContent = names && `off the axis: ${names}`;
    [curves.width, curves.height] = [canvas.width, canvas.height];
    curves.getContext("2d").drawImage(canvas, 0, 0);
    this.describe(policies);
  }

  drawAxes(context, width, height) {
    const bottom = height - EDGE.bottom;
    context.font = font(12);
    context.textBaseline = "middle";
    context.textAlign = "right";
    const decades = Math.round(Math.log10(this.high / this.low));
    const levels = this.kind.log
      ? Array.from({ length: decades + 1 }, (_, k) => this.low * 10 ** k).filter((_, k) => decades < 6 || k % 2 === 0)
      : ticks(this.low, this.high, 5);
    for (const level of levels) {
      const zero = !this.kind.log && Math.abs(level) < 1e-12;
      const line = [[EDGE.left, this.y(level)], [width - EDGE.right, this.y(level)]];
      stroke(context, line, zero ? colours.reference : colours.line, 1);
      context.fillStyle = colours.soft;
      context.fillText(label(level, this.kind.log), EDGE.left - 7, this.y(level));
    }
    context.textAlign = "center";
    const last = state.scene.time.at(-1);
    for (const time of ticks(0, last, width < 420 ? 3 : 6)) {
      stroke(context, [[this.x(time), bottom], [this.x(time), bottom + 4]], colours.soft, 1);
      context.fillText(label(time), this.x(time), bottom + 12);
    }
    context.fillText("time [s]", 0.5 * (EDGE.left + width - EDGE.right), bottom + 27);
  }

  /** Mark the early end of an episode. */
  cross(context, [right, down], colour) {
    stroke(context, [[right - 5, down - 5], [right + 5, down + 5]], colour, 2.5);
    stroke(context, [[right - 5, down + 5], [right + 5, down - 5]], colour, 2.5);
  }

  describe(policies) {
    const names = policies.map((policy) => report.policies[policy]).join(", ") || "no policy chosen";
    const { title, unit } = this.kind;
    this.canvas.setAttribute("aria-label", `${title} in ${unit} over time, ${state.scene.title}: ${names}`);
  }

  draw() {
    const context = fitted(this.canvas);
    if (!this.curves.width) return;
    context.drawImage(this.curves, 0, 0, this.canvas.clientWidth, this.canvas.clientHeight);
    const x = this.x(state.scene.time[state.sample]);
    stroke(context, [[x, EDGE.top], [x, this.canvas.clientHeight - EDGE.bottom]], colours.ink, 1.2);
    for (const policy of chosen()) {
      const run = state.scene.runs[policy];
      if (state.sample >= run.samples) continue;
      const value = this.kind.signal(run, state.sample);
      if (value > this.high || (value < this.low && !this.kind.log)) continue;
      const place = [x, this.y(Math.max(value, this.kind.log ? this.low : value))];
      disc(context, place, 4.5, colours.paper);
      disc(context, place, 3.2, colourOf(policy));
    }
  }
}
