// Colours of the page's style, canvases in CSS pixels, and the shapes that are drawn on them.

const probe = document.createElement("span");
document.body.append(probe);
probe.hidden = true;
let colours = {};

/** Read the colours of the style for the current theme; canvases cannot use CSS variables. */
function readColours() {
  const names = ["paper", "ink", "soft", "line", "reference", "reach", "steel", "edge", "force", "payload"];
  for (const name of [...names, ...report.policies.map((_, policy) => colourClass(policy))]) {
    probe.style.color = `var(--${name})`;
    colours[name] = getComputedStyle(probe).color;
  }
}

const colourOf = (policy) => colours[colourClass(policy)];
const dashesOf = (policy) => DASHES[policy % DASHES.length];
const font = (size, weight = "") => `${weight} ${size}px ${getComputedStyle(document.body).fontFamily}`;

/**
 * Give a canvas the resolution of its box. This reads the layout, so it is called only when the layout may have changed,
 * for all canvases before any of them is drawn.
 */
function fit(canvas) {
  const ratio = window.devicePixelRatio || 1;
  canvas.box = { width: canvas.clientWidth, height: canvas.clientHeight, ratio };
  const [width, height] = [Math.round(canvas.box.width * ratio), Math.round(canvas.box.height * ratio)];
  if (canvas.width !== width) canvas.width = width;
  if (canvas.height !== height) canvas.height = height;
}

/** Return a canvas for the parts of another one that do not move. */
function stillOf(canvas) {
  const still = element("canvas", { width: canvas.width, height: canvas.height });
  still.box = canvas.box;
  return still;
}

/** Clear a canvas and return its context in CSS pixels. */
function cleared(canvas) {
  const context = canvas.getContext("2d"), { width, height, ratio } = canvas.box;
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  context.lineJoin = context.lineCap = "round";
  return context;
}

/** Return a new element with properties and children. */
function element(tag, properties = {}, ...children) {
  const made = Object.assign(document.createElement(tag), properties);
  made.append(...children);
  return made;
}

/** Return an element with a text that can be changed without a new layout of anything else. */
function changingText(tag, properties = {}) {
  const text = document.createTextNode(""), made = element(tag, properties, text);
  return { made, set: (value) => { if (text.data !== value) text.data = value; } };
}

function stroke(context, points, colour, width, dashes = []) {
  context.strokeStyle = colour;
  context.lineWidth = width;
  context.setLineDash(dashes);
  context.beginPath();
  points.forEach(([right, down], k) => (k ? context.lineTo(right, down) : context.moveTo(right, down)));
  context.stroke();
  context.setLineDash([]);
}

function polygon(context, corners, colour) {
  context.fillStyle = colour;
  context.beginPath();
  for (const corner of corners) context.lineTo(...corner);
  context.fill();
}

function disc(context, [right, down], radius, colour) {
  context.fillStyle = colour;
  context.beginPath();
  context.arc(right, down, radius, 0, 2 * Math.PI);
  context.fill();
}
