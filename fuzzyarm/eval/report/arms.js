// The picture of each arm at the current instant of its rollout.

/**
 * Return the part of the picture's plane [m] that every picture shows: the base, the reference with room around it, and
 * the arm of one run of each case, the one that went farthest with the smallest error.
 */
function viewOf(scenes) {
  const size = report.robot?.reach ?? 1, base = shape.seen(shape.points(Array(JOINTS).fill(0))[0]);
  const around = [0.1 * size, report.robot ? 0.1 * size : 0.06], low = base.map((at, k) => at - around[k]);
  const high = base.map((at, k) => at + around[k]);
  const include = (point, room) => shape.seen(point).forEach((value, axis) => {
    low[axis] = Math.min(low[axis], value - room);
    high[axis] = Math.max(high[axis], value + room);
  });
  for (const { runs, time, reference } of scenes) {
    const steadier = (a, b) => b.samples - a.samples || a.peak - b.peak;
    const { samples, link } = [...runs].sort(steadier)[0];
    for (let k = 0; k < samples; k += 10) {
      for (const point of shape.within(jointsAt(link, k))) include(point, 0.06 * size);
    }
    for (let k = 0; k < time.length; k += 10) include(placeAt(reference, k), ROOM);
  }
  return { low, high };
}

/** The picture of the arm under one policy. */
class Arm {
  constructor(policy) {
    this.policy = policy;
    this.canvas = element("canvas");
    this.canvas.setAttribute("role", "img");
    this.canvas.style.aspectRatio = (view.high[1] - view.low[1]) / (view.high[0] - view.low[0]);
    this.note = element("span", { className: "badge", title: "the tip error of this policy is not magnified" });
    this.error = changingText("b");
    this.torque = changingText("span");
    const name = element("b", { textContent: report.policies[policy], title: report.policies[policy] });
    const caption = element("figcaption", {}, name, this.note);
    const readout = element("p", { className: "readout" }, this.error.made, this.torque.made);
    this.figure = element("figure", { className: colourClass(policy) }, caption, this.canvas, readout);
    this.figure.dataset.policy = policy;
  }

  /** Write what holds for the whole case. */
  describe() {
    const { scene } = state, run = scene.runs[this.policy], name = report.policies[this.policy];
    this.figure.hidden = !state.chosen.has(this.policy);
    this.note.textContent = factorOf(run) === magnification() ? "" : "to scale";
    this.note.hidden = !this.note.textContent;
    const worst = lengthText(run.peak);
    this.canvas.setAttribute("aria-label", `Arm under ${name}, ${scene.title}, tip error up to ${worst}`);
  }

  /** Draw the fixed parts on a hidden canvas that `draw` copies. */
  prepare() {
    const { scene } = state, run = scene.runs[this.policy], { low, high } = view, { width, height } = this.canvas.box;
    const scale = Math.min(width / (high[1] - low[1]), height / (high[0] - low[0]));
    this.scale = scale;
    this.pixel = (point) => {
      const [down, right] = shape.seen(point);
      return [0.5 * width + scale * (right - 0.5 * (low[1] + high[1])),
        0.5 * height + scale * (down - 0.5 * (low[0] + high[0]))];
    };
    this.factor = factorOf(run);
    this.still = stillOf(this.canvas);
    const context = cleared(this.still);
    const places = Array.from(scene.time, (_, sample) => this.reference(sample)), path = places.map(this.pixel);
    shape.ground(context, this.pixel, scale, places);
    stroke(context, path, colours.reference, Math.max(2, 0.012 * scale));
    const trace = Array.from({ length: run.samples }, (_, sample) => this.pixel(this.magnified(sample)));
    // Points closer than a pixel to the one before are left out of the trace, which is drawn at every instant.
    this.trace = [];
    trace.forEach((point, sample) => {
      const last = this.trace.at(-1)?.point;
      if (!last || Math.hypot(point[0] - last[0], point[1] - last[1]) > 1) this.trace.push({ sample, point });
    });
    context.globalAlpha = 0.3;
    stroke(context, trace, colourOf(this.policy), 1.5);
  }

  reference(sample) {
    return placeAt(state.scene.reference, sample);
  }

  /** Return the tip, its deviation from the reference magnified. */
  magnified(sample) {
    const deviation = placeAt(state.scene.runs[this.policy].deviation, sample);
    return this.reference(sample).map((value, axis) => value + this.factor * deviation[axis]);
  }

  /** Draw the arm at the current instant. */
  draw() {
    const { scene } = state, run = scene.runs[this.policy], k = sampleOf(run), { scale, pixel } = this;
    const context = cleared(this.canvas), { width, height } = this.canvas.box;
    if (!width || !height) return;
    context.drawImage(this.still, 0, 0, width, height);

    // The arm at its motor angles, with magnified bending, lies under the links.
    const angles = jointsAt(run.link, k), bending = jointsAt(run.bending, k);
    const motors = shape.points(angles.map((angle, joint) => angle + BENDING * bending[joint]));
    shape.shadow(context, pixel, scale, angles);
    stroke(context, motors.map(pixel), colours.soft, 1.5, [5, 4]);
    shape.arm(context, pixel, scale, angles);
    const end = shape.points(angles).at(-1), tip = pixel(end);
    if (scene.payload) drawPayload(context, tip, scene.payload, scale);
    if (scene.force) {
      const force = placeAt(scene.force, state.sample);
      drawForce(context, tip, shape.across(end, force), Math.hypot(...force), scale);
    }
    this.drawTrace(context, k);
    if (run.ended && state.sample >= run.samples - 1) drawEnd(context, width, run.ended);
  }

  /** Draw the path of the tip so far, and the deviation at sample k. */
  drawTrace(context, k) {
    const here = this.pixel(this.magnified(k)), reference = this.pixel(this.reference(k));
    const past = this.trace.filter(({ sample }) => sample < k).map(({ point }) => point);
    stroke(context, [...past, here], colourOf(this.policy), 2.5);
    stroke(context, [reference, here], colours.ink, 1.2);
    disc(context, reference, 2.5, colours.ink);
    disc(context, here, 6.5, colours.paper);
    disc(context, here, 5, colourOf(this.policy));
  }

  /** Write the values at the current instant. */
  write() {
    const run = state.scene.runs[this.policy], k = sampleOf(run);
    this.error.set(lengthText(run.error[k]));
    this.torque.set(torqueText(jointsAt(run.torque, k)));
  }
}

function drawPayload(context, tip, mass, scale) {
  const radius = Math.max(6, 0.022 * scale * Math.cbrt(mass));
  disc(context, tip, radius + 1.5, colours.edge);
  disc(context, tip, radius, colours.payload);
  context.fillStyle = "#1c2630";
  context.font = font(Math.min(11, radius), "600");
  context.textAlign = "center";
  context.textBaseline = "middle";
  context.fillText(`${mass}`, ...tip);
}

/** Write the torques [N m] of few joints or, of many, how near the next limit is. */
function torqueText(torques) {
  if (!report.robot) return `Γ ${torques.map(signed).join(", ")}`;
  const share = Math.max(...torques.map((torque, joint) => Math.abs(torque) / report.robot.torque[joint]));
  return `Γ ≤ ${(100 * share).toFixed(0)} %`;
}

/** Draw an arrow that points at the tip; `seen` is what is seen of a force of this `size` [N], [right, down] in N. */
function drawForce(context, tip, seen, size, scale) {
  const long = Math.hypot(...seen);
  if (size < 1 || long < 0.02 * size) return;
  const [right, down] = seen.map((part) => part / long);
  const at = (back, side) => [tip[0] - back * right - side * down, tip[1] - back * down + side * right];
  const shaft = (0.16 * scale * (report.robot?.reach ?? 1) * long) / state.scene.strongest, head = 0.3 * shaft;
  stroke(context, [at(shaft, 0), at(head, 0)], colours.force, 4);
  polygon(context, [at(0, 0), at(head + 4, 0.6 * head), at(head + 4, -0.6 * head)], colours.force);
  context.font = font(12, "600");
  context.textAlign = "center";
  context.textBaseline = "middle";
  context.fillText(`${size.toFixed(0)} N`, ...at(shaft + 14, 0));
}

/** Write when and why an episode ended early. */
function drawEnd(context, width, ended) {
  context.font = font(12, "600");
  context.textAlign = "center";
  context.textBaseline = "top";
  context.fillStyle = colours.ink;
  wrapped(context, `ended early at ${ended.time.toFixed(3)} s: ${ended.reason}`, width - 20).forEach((line, row) => {
    const half = 0.5 * context.measureText(line).width + 4;
    context.fillStyle = colours.paper;
    context.fillRect(0.5 * width - half, 6 + 16 * row, 2 * half, 16);
    context.fillStyle = colours.ink;
    context.fillText(line, 0.5 * width, 8 + 16 * row);
  });
}

/** Break a text into lines of at most `width` pixels. */
function wrapped(context, text, width) {
  const lines = [""];
  for (const word of text.split(" ")) {
    const longer = `${lines.at(-1)} ${word}`.trim();
    if (context.measureText(longer).width <= width) lines[lines.length - 1] = longer;
    else lines.push(word);
  }
  return lines;
}

/** Return the magnification of deviations: the chosen one, or one that keeps most policies near the reference. */
function magnification() {
  if ($("magnification").value !== "auto") return Number($("magnification").value);
  const peaks = chosen().map((policy) => state.scene.runs[policy].peak).sort((a, b) => a - b);
  const typical = peaks[Math.floor(0.75 * (peaks.length - 1))];
  return MAGNIFICATIONS.findLast((factor) => factor * typical <= 1.2 * ROOM) ?? 1;
}

/** Return the magnification for a run; one that would leave the picture is drawn to scale by default. */
function factorOf(run) {
  const factor = magnification();
  return $("magnification").value === "auto" && factor * run.peak > 5 * ROOM ? 1 : factor;
}
