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

/** Fit a canvas to its box, clear it, and return its context in CSS pixels. */
function fitted(canvas) {
  const ratio = window.devicePixelRatio || 1;
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
  }
  const context = canvas.getContext("2d");
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
