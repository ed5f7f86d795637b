// The page: its controls, and what they show.

const view = viewOf(report.cases);
// [px]: between cards, of the text above and below a picture, of the narrowest card, and of one with its values in a row
const CARD_GAP = 8, CARD_TEXT = 52, NARROWEST = 165, IN_A_ROW = 215;
const plots = PLOTS.map((kind) => new Plot(kind));
const arms = report.policies.map((_, policy) => new Arm(policy));

/** Return a length in millimetres or, below 0.01 mm, in micrometres. */
function lengthText(metres) {
  const millimetres = 1e3 * metres;
  if (millimetres >= 100) return `${millimetres.toFixed(0)} mm`;
  if (millimetres >= 0.01) return `${millimetres.toFixed(millimetres < 10 ? (millimetres < 1 ? 3 : 2) : 1)} mm`;
  return millimetres < 1e-3 ? "< 0.001 mm" : `${(1e3 * millimetres).toFixed(2)} µm`;
}

const signed = (value) => value.toFixed(1).replace("-", "−");

const timeText = (sample) => `${state.scene.time[sample].toFixed(3)} s`;
const clockText = changingText("span");

/** Draw the current instant without reading the layout, so that a picture costs one layout at most. */
function show() {
  const { sample } = state, time = timeText(sample);
  for (const policy of chosen()) arms[policy].draw();
  plots.forEach((plot) => plot.draw());
  $("scrubber").value = sample;
  $("scrubber").setAttribute("aria-valuetext", time);
  clockText.set(time);
  for (const policy of chosen()) arms[policy].write();
  plots.forEach((plot) => plot.write());
}

/** Show the values below the pointer in all plots; null shows those of the current instant again. */
function pointAt(sample) {
  if (sample === state.pointed) return;
  state.pointed = sample;
  for (const plot of plots) {
    plot.draw();
    plot.write();
  }
}

/** Return how many columns of cards make the largest pictures in a box of this size. */
function columnsFor(count, { width, height }) {
  const ratio = (view.high[0] - view.low[0]) / (view.high[1] - view.low[1]);
  let [best, largestWidth] = [1, 0];
  const most = Math.min(count, Math.max(1, Math.floor(width / NARROWEST)));
  for (let columns = 1; columns <= most; columns += 1) {
    const cell = (height - CARD_GAP) / Math.ceil(count / columns) - CARD_GAP - CARD_TEXT - (width / columns < IN_A_ROW ? 14 : 0);
    const picture = Math.min(width / columns - CARD_GAP, cell / ratio);
    if (picture > largestWidth * 1.001) [best, largestWidth] = [columns, picture];
  }
  return best;
}

/** Divide the arms into columns: to fill the screen beside the plots, or else as wide as they are legible. */
function arrangeArms() {
  const count = Math.max(1, state.chosen.size), box = $("arms").getBoundingClientRect();
  const beside = getComputedStyle($("panel")).display === "grid";
  const fitting = Math.max(2, Math.floor(box.width / 236));
  const columns = beside ? columnsFor(count, box) : Math.max(2, Math.ceil(count / Math.ceil(count / fitting)));
  $("arms").style.gridTemplateColumns = `repeat(${columns}, minmax(0, 1fr))`;
}

/** Lay out and draw everything again, after a change of the case, the chosen policies, the size or the theme. */
function refresh() {
  readColours();
  const { scene } = state, worst = worstPolicy();
  state.sample = Math.min(state.sample, scene.time.length - 1);
  state.pointed = null;
  $("scrubber").max = scene.time.length - 1;
  document.querySelector("#key .force").hidden = !scene.force;
  $("magnified").textContent = magnification() === 1 ? "to scale" : `× ${magnification()}`;
  $("worst").hidden = worst === null;
  if (worst !== null) {
    const { peak } = scene.runs[worst];
    $("worst").textContent = `Largest error: ${report.policies[worst]}, ${lengthText(peak)}`;
  }
  document.querySelectorAll('[role="tab"]').forEach((tab, index) => {
    const selected = report.cases[index] === scene;
    tab.setAttribute("aria-selected", selected);
    tab.tabIndex = selected ? 0 : -1;
  });
  $("screen").style.setProperty("--rows", state.chosen.size + 1); // of values beside a plot
  arms.forEach((arm) => arm.describe());
  arrangeArms();
  layOut();
}

/** Measure all canvases, then draw them. */
function layOut() {
  const keys = [...document.querySelectorAll(".chip canvas")];
  [...keys, ...chosen().map((policy) => arms[policy].canvas), ...plots.map(({ canvas }) => canvas)].forEach(fit);
  keys.forEach((canvas, policy) => {
    const context = cleared(canvas);
    context.lineCap = "butt";
    stroke(context, [[0, 6], [34, 6]], colourOf(policy), 3, dashesOf(policy));
  });
  for (const policy of chosen()) arms[policy].prepare();
  plots.forEach((plot) => plot.prepare());
  show();
}

/** Return the sample nearest to a time [s]. */
function nearest(time) {
  const times = state.scene.time;
  let [low, high] = [0, times.length - 1];
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (times[middle] <= time) low = middle;
    else high = middle;
  }
  return time - times[low] < times[high] - time ? low : high;
}

function goTo(sample) {
  state.sample = Math.max(0, Math.min(state.scene.time.length - 1, sample));
  state.clock = state.scene.time[state.sample];
  show();
}

function setPlaying(playing) {
  state.playing = playing;
  $("play").textContent = playing ? "❚❚ Pause" : "▶ Play";
  if (!playing) return;
  if (state.sample === state.scene.time.length - 1) goTo(0);
  state.clock = state.scene.time[state.sample];
  let before = performance.now();
  requestAnimationFrame(function frame(now) {
    if (!state.playing) return;
    const elapsed = Math.max(0, now - before) / 1e3;
    if (!reducedMotion.matches || elapsed >= STEP) {
      before = now;
      state.clock += elapsed * Number($("speed").value);
      if (state.clock >= state.scene.time.at(-1)) {
        if ($("loop").checked) state.clock = state.scene.time[0];
        else {
          goTo(state.scene.time.length - 1);
          return setPlaying(false);
        }
      }
      state.sample = nearest(state.clock);
      show();
    }
    requestAnimationFrame(frame);
  });
}

function selectCase(index) {
  if (!report.cases[index]) return;
  state.scene = report.cases[index];
  if (!state.playing) state.sample = worstSample();
  refresh();
  goTo(state.sample);
}

function setTheme(theme) {
  document.documentElement.dataset.theme = theme;
  $("theme").textContent = theme === "dark" ? "Light" : "Dark";
  $("theme").setAttribute("aria-label", `Switch to ${theme === "dark" ? "light" : "dark"} colours`);
  refresh();
}

function build() {
  report.cases.forEach((scene, index) => {
    const tab = element("button", { type: "button", textContent: scene.title, onclick: () => selectCase(index) });
    tab.setAttribute("role", "tab");
    tab.setAttribute("aria-controls", "panel");
    $("cases").append(tab);
  });
  $("cases").addEventListener("keydown", (event) => {
    const tabs = [...$("cases").children], turn = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
    if (!turn) return;
    event.stopPropagation();
    const next = (tabs.indexOf(document.activeElement) + turn + tabs.length) % tabs.length;
    selectCase(next);
    tabs[next].focus();
  });
  report.policies.forEach((name, policy) => {
    const box = element("input", { type: "checkbox", checked: state.chosen.has(policy) });
    box.addEventListener("change", () => {
      if (box.checked) state.chosen.add(policy);
      else state.chosen.delete(policy);
      refresh();
    });
    const chip = element("label", { className: `chip ${colourClass(policy)}` }, box, element("canvas"), name);
    const highlight = (on) => () => {
      state.highlighted = on ? policy : null;
      for (const plot of plots) {
        plot.prepare();
        plot.draw();
      }
    };
    chip.addEventListener("pointerenter", highlight(true));
    chip.addEventListener("pointerleave", highlight(false));
    $("policies").append(chip);
  });
  $("magnification").append(element("option", { value: "auto", textContent: "× auto" }),
    ...MAGNIFICATIONS.map((factor) => element("option", { value: factor, textContent: `× ${factor}` })));
  $("arms").append(...arms.map(({ figure }) => figure));
  $("plots").append(...plots.map(({ figure }) => figure));
  $("time").append(clockText.made);
  $("plots").classList.toggle("many", plots.length > 6);
  if (report.robot) $("torques").textContent = "Γ share of a limit";
  for (const part of [document.querySelector(".controls"), $("policies"), $("key"), $("theme")]) part.hidden = false;
}

/** Handle the keys of the page, unless the focused control uses the key itself. */
function onKey(event) {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  const focused = event.target.tagName, own = focused === "SELECT" || event.target.closest("[role=region]");
  const pressed = focused === "BUTTON" || focused === "SUMMARY" || event.target.type === "checkbox";
  const far = event.shiftKey ? 50 : 1;
  const actions = {
    " ": () => setPlaying(!state.playing),
    ArrowLeft: () => goTo(state.sample - far),
    ArrowRight: () => goTo(state.sample + far),
    Home: () => goTo(0),
    e: () => goTo(worstSample()),
    End: () => goTo(state.scene.time.length - 1),
  };
  const action = actions[event.key] ?? (/^[1-9]$/.test(event.key) ? () => selectCase(Number(event.key) - 1) : null);
  if (!action || own || (event.key === " " && pressed)) return;
  event.preventDefault();
  action();
}

build();
$("play").addEventListener("click", () => setPlaying(!state.playing));
$("scrubber").addEventListener("input", () => goTo(Number($("scrubber").value)));
$("worst").addEventListener("click", () => goTo(worstSample()));
$("magnification").addEventListener("change", refresh);
$("theme").addEventListener("click", () => {
  const dark = (document.documentElement.dataset.theme ?? (systemDark.matches ? "dark" : "light")) === "dark";
  setTheme(dark ? "light" : "dark");
});
systemDark.addEventListener("change", () => {
  $("theme").textContent = systemDark.matches ? "Light" : "Dark";
  delete document.documentElement.dataset.theme;
  refresh();
});
document.addEventListener("keydown", onKey);
$("theme").textContent = systemDark.matches ? "Light" : "Dark";
window.addEventListener("resize", refresh);
selectCase(report.cases.indexOf(hardest));
