"use strict";
// The page of `rig pick`. The server keeps the corners and solves; this draws them and says what was clicked.

const GRAB = 14; // screen px within which a pointer takes hold of a corner
const MOVED = 4; // screen px after which a press is a drag
const MAGNIFIED = 8; // screen px a picture px in the magnifier
const SETTLED = 250; // ms after the last arrow key that a corner is sent
const FAR = 3; // sigmas beyond which a residual is said in red
const COLOURS = { given: "#ffb000", active: "#00c8ff", predicted: "#5ee08a" };

const byId = (id) => document.getElementById(id);
const state = { corners: [], predicted: {}, active: { camera: 0, rectangle: 0, corner: 0 }, frameset: 0 };
const views = []; // one a camera: canvas, picture, where it is looked at
let cursor = null; // picture px, in the active picture, where keys act
let nudged = false; // whether keys moved it since its corner became active
let hover = null; // {camera, x, y} under the mouse
let snapped = null; // {camera, rectangle, corner, from, to} of the last snap
let drag = null;
let moving = null; // timer of an arrow key's corner that is not sent yet
let tabWalks = false; // whether Tab walks over the page instead of the corners
let asked = 0;

async function ask(path, body, { quiet = false } = {}) {
  const options = body && {
    method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(body),
  };
  let answer;
  try {
    const reply = await fetch(path, options);
    answer = await reply.json();
  } catch {
    return problem("rig pick does not answer: it has ended, or is busy; nothing new is kept"), null;
  }
  if (!quiet) problem(answer.problem || "");
  return answer.problem ? null : answer;
}

function problem(text) {
  byId("problem").textContent = text;
  byId("problem").hidden = !text;
}

// What is where

const camera = (index = state.active.camera) => state.cameras[index];
const rectangle = () => state.rectangles[state.active.rectangle];
const image = (index = state.active.camera) => state.images[state.frameset][index];

function tableOf(cameraIndex, one = rectangle()) {
  return state.corners.find((table) => table.camera === camera(cameraIndex).name && table.rectangle === one.name
    && (!one.moving || (table.image ?? 0) === image(cameraIndex)));
}
const pixelsOf = (cameraIndex, one) => tableOf(cameraIndex, one)?.pixels ?? [null, null, null, null];
const predictedOf = (cameraIndex, one = rectangle()) => state.predicted[camera(cameraIndex).name]?.[one.name]
  ?? [null, null, null, null];
const given = () => pixelsOf(state.active.camera)[state.active.corner];

function residual(cameraIndex, corner) {
  const [seen, said] = [pixelsOf(cameraIndex)[corner], predictedOf(cameraIndex)[corner]];
  return seen && said && tableOf(cameraIndex).pixels.every(Boolean)
    ? Math.hypot(seen[0] - said[0], seen[1] - said[1]) : null;
}

// Changes

const about = () => ({ camera: camera().name, rectangle: rectangle().name, image: image() });

// Changes go to the server one after another; what is drawn does not wait for them. Where several are on their way only
// the last answer has all of them.
let pending = 0;
let queue = Promise.resolve();

function change(body) {
  pending += 1;
  queue = queue.then(() => ask("change", body)).then(async (answer) => {
    pending -= 1;
    // What was refused is not kept: show what is.
    const kept = answer ?? await ask("session", null, { quiet: true });
    if (pending || !kept) return answer;
    Object.assign(state, { corners: kept.corners, can_undo: kept.can_undo, can_redo: kept.can_redo });
    draw();
    solve();
    return answer;
  });
  return queue;
}

// The table of the active rectangle and picture, made where there is none yet.
function ownTable() {
  if (!tableOf(state.active.camera)) {
    const own = rectangle().moving ? image() : null;
    state.corners.push({ ...about(), image: own, sigma: 1, pixels: [null, null, null, null], problem: "" });
  }
  return tableOf(state.active.camera);
}

async function solve() {
  const ticket = ++asked;
  const answer = await ask(`solution?frameset=${state.frameset}`);
  if (!answer || ticket !== asked) return;
  state.predicted = answer.predicted;
  state.status = answer.status;
  // A corner that can be foreseen now is waited for where it should be.
  if (!given() && !nudged) cursor = [...(predictedOf(state.active.camera)[state.active.corner] ?? cursor)];
  document.body.dataset.solved = ticket;
  draw();
}

async function place(x, y, { snap = true, advance = true } = {}) {
  if (image() < 0) return;
  const { width, height } = camera();
  const at = [Math.min(Math.max(x, -0.5), width - 0.5), Math.min(Math.max(y, -0.5), height - 0.5)];
  const here = { ...state.active };
  const name = `${state.corner_names[here.corner]} of ${rectangle().name} in ${camera().name}`;
  ownTable().pixels[here.corner] = at;
  const sent = change({ do: "place", ...about(), corner: here.corner, x: at[0], y: at[1], snap });
  const next = [1, 2, 3].map((step) => (here.corner + step) % 4).find((corner) => !pixelsOf(here.camera)[corner]);
  if (advance && next !== undefined) activate({ corner: next });
  else cursor = [...at];
  draw();
  const answer = await sent;
  if (!answer) return;
  snapped = answer.snapped && { ...here, from: at, to: answer.snapped };
  const off = snapped && Math.hypot(at[0] - snapped.to[0], at[1] - snapped.to[1]);
  say(snapped ? `${name}: snapped by ${off.toFixed(1)} px; U takes that back`
    : snap ? `${name}: no crossing of edges within 5 px, kept where you pointed` : `${name}: moved`);
  if (given()) cursor = [...given()];
  draw();
}

function nudge(dx, dy) {
  if (!cursor) return;
  nudged = true;
  const { width, height } = camera();
  cursor = [Math.min(Math.max(cursor[0] + dx, 0), width - 1), Math.min(Math.max(cursor[1] + dy, 0), height - 1)];
  hover = null;
  if (given()) {
    tableOf(state.active.camera).pixels[state.active.corner] = [...cursor];
    clearTimeout(moving);
    moving = setTimeout(settle, SETTLED);
  }
  keepInSight();
  draw();
}

async function settle() {
  if (!moving) return;
  clearTimeout(moving);
  moving = null;
  await place(...cursor, { snap: false, advance: false });
}

const COMMANDS = {
  undo: () => step("undo"),
  redo: () => step("redo"),
  snap: () => given() && place(...given(), { advance: false }),
  remove: () => {
    if (!given()) return;
    const sent = change({ do: "remove", ...about(), corner: state.active.corner });
    tableOf(state.active.camera).pixels[state.active.corner] = null;
    draw();
    return sent;
  },
  earlier: () => instant(-1),
  later: () => instant(1),
};

async function step(which) {
  const answer = await change({ do: which });
  if (!answer) return;
  snapped = null;
  const changed = answer.changed;
  if (!changed) return say(`nothing to ${which}`);
  activate({
    camera: state.cameras.findIndex((one) => one.name === changed.camera),
    rectangle: state.rectangles.findIndex((one) => one.name === changed.rectangle),
    corner: changed.corner,
  });
  say(`${which === "undo" ? "taken back" : "done again"}: ${state.corner_names[changed.corner]} of ${changed.rectangle}`
    + ` in ${changed.camera}`);
}

function instant(by) {
  const last = state.images.length - 1;
  state.frameset = Math.min(Math.max(state.frameset + by, 0), last);
  views.forEach(load);
  activate({});
  solve();
}

function activate(to) {
  Object.assign(state.active, to);
  nudged = false;
  const corner = state.active.corner;
  const { width, height } = camera();
  cursor = [...(given() ?? predictedOf(state.active.camera)[corner] ?? [(width - 1) / 2, (height - 1) / 2])];
  hover = null;
  keepInSight();
  draw();
}

// Another picture or rectangle goes on with its own next corner.
function enter(to) {
  const active = { ...state.active, ...to };
  const next = pixelsOf(active.camera, state.rectangles[active.rectangle]).findIndex((pixel) => !pixel);
  activate({ ...to, corner: next < 0 ? active.corner : next });
}

const turned = (key, count, by) => ({ [key]: (state.active[key] + by + count) % count });

// Looking: each view has scale (screen px a picture px) and the picture's px at its middle

function fit(view) {
  const { width, height } = camera(view.index);
  Object.assign(view, { scale: view.canvas.clientWidth / width, middle: [(width - 1) / 2, (height - 1) / 2] });
}

function toScreen(view, [x, y]) {
  return [(x - view.middle[0]) * view.scale + view.canvas.clientWidth / 2,
    (y - view.middle[1]) * view.scale + view.canvas.clientHeight / 2];
}

function toPicture(view, event) {
  const box = view.canvas.getBoundingClientRect();
  return [(event.clientX - box.left - view.canvas.clientWidth / 2) / view.scale + view.middle[0],
    (event.clientY - box.top - view.canvas.clientHeight / 2) / view.scale + view.middle[1]];
}

function zoom(view, factor, [x, y]) {
  const least = view.canvas.clientWidth / camera(view.index).width;
  const scale = Math.min(Math.max(view.scale * factor, least), 40);
  const share = view.scale / scale;
  view.middle = [x + (view.middle[0] - x) * share, y + (view.middle[1] - y) * share];
  view.scale = scale;
  if (scale === least) fit(view);
  draw();
}

function keepInSight() {
  const view = views[state.active.camera];
  if (!view || !cursor) return;
  const [x, y] = toScreen(view, cursor);
  const inside = x > 20 && y > 20 && x < view.canvas.clientWidth - 20 && y < view.canvas.clientHeight - 20;
  if (!inside && view.scale > 1.01 * view.canvas.clientWidth / camera(view.index).width) view.middle = [...cursor];
}

async function load(view) {
  const wanted = image(view.index);
  if (view.shown === wanted) return;
  view.shown = wanted;
  view.picture = null;
  if (wanted < 0) return;
  const query = new URLSearchParams({ camera: camera(view.index).name, image: wanted });
  const reply = await fetch(`picture?${query}`);
  if (!reply.ok) return problem((await reply.json()).problem);
  const picture = await createImageBitmap(await reply.blob());
  if (view.shown === wanted) view.picture = picture;
  document.body.dataset.loaded = views.filter((one) => one.picture || one.shown < 0).length;
  draw();
}

// As many columns as make the pictures largest while all of them fit on the screen.
function arrange() {
  const grid = byId("pictures");
  const shown = grid.classList.contains("alone") ? 1 : views.length;
  const [gap, caption] = [16, 34];
  const tall = Math.max(...state.cameras.map((one) => one.height / one.width));
  const height = window.innerHeight - grid.getBoundingClientRect().top - window.scrollY - gap;
  const widths = [...Array(shown).keys()].map((k) => {
    const rows = Math.ceil(shown / (k + 1));
    return Math.min((grid.clientWidth - k * gap) / (k + 1), ((height - (rows - 1) * gap) / rows - caption) / tall);
  });
  const width = Math.max(...widths, Math.min(320, grid.clientWidth));
  const columns = Math.max(widths.indexOf(width), 0) + 1;
  grid.style.gridTemplateColumns = `repeat(${columns}, minmax(0, ${Math.floor(width)}px))`;
}

// Drawing

function context(canvas) {
  const ratio = window.devicePixelRatio || 1;
  const [width, height] = [Math.round(canvas.clientWidth * ratio), Math.round(canvas.clientHeight * ratio)];
  if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
  const pen = canvas.getContext("2d");
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, canvas.clientWidth, canvas.clientHeight);
  return pen;
}

function drawPicture(pen, view, scale, middle, width, height) {
  // The centre of the top-left pixel is 0, 0: its corner lies half a pixel before it.
  pen.imageSmoothingEnabled = scale < 2;
  pen.imageSmoothingQuality = "high";
  const left = (-0.5 - middle[0]) * scale + width / 2;
  const top = (-0.5 - middle[1]) * scale + height / 2;
  pen.drawImage(view.picture, left, top, view.picture.width * scale, view.picture.height * scale);
}

function line(pen, points, colour, dash = [], width = 1.5) {
  for (const [ink, wide] of [["#000a", width + 2], [colour, width]]) {
    pen.beginPath();
    points.forEach(([x, y], k) => (k ? pen.lineTo(x, y) : pen.moveTo(x, y)));
    Object.assign(pen, { strokeStyle: ink, lineWidth: wide });
    pen.setLineDash(dash);
    pen.stroke();
  }
  pen.setLineDash([]);
}

function cross(pen, [x, y], colour, size = 9, gap = 3) {
  for (const [dx, dy] of [[1, 0], [-1, 0], [0, 1], [0, -1]]) {
    line(pen, [[x + gap * dx, y + gap * dy], [x + size * dx, y + size * dy]], colour);
  }
}

function ring(pen, [x, y], colour, radius, dash = []) {
  const steps = [...Array(25).keys()].map((k) => k * Math.PI / 12);
  line(pen, steps.map((a) => [x + radius * Math.cos(a), y + radius * Math.sin(a)]), colour, dash);
}

function label(pen, text, [x, y], colour) {
  pen.font = "600 12px system-ui, sans-serif";
  Object.assign(pen, { strokeStyle: "#000c", lineWidth: 3, lineJoin: "round", fillStyle: colour });
  // Beside the corner, on the side where there is room for it.
  const wide = pen.measureText(text).width;
  const left = x + 10 + wide > pen.canvas.clientWidth ? x - 10 - wide : x + 10;
  const base = y < 24 ? y + 20 : y - 10;
  pen.strokeText(text, left, base);
  pen.fillText(text, left, base);
}

function drawView(view) {
  const pen = context(view.canvas);
  if (!view.picture) {
    pen.fillStyle = "#999";
    pen.font = "14px system-ui, sans-serif";
    pen.fillText(view.shown < 0 ? "no picture of this instant" : "…", 16, 28);
    return;
  }
  drawPicture(pen, view, view.scale, view.middle, view.canvas.clientWidth, view.canvas.clientHeight);
  const on = (pixels) => pixels.map((pixel) => pixel && toScreen(view, pixel));
  state.rectangles.forEach((one, index) => {
    const [seen, said] = [on(pixelsOf(view.index, one)), on(predictedOf(view.index, one))];
    const own = index === state.active.rectangle;
    pen.globalAlpha = own ? 1 : 0.4;
    if (seen.every(Boolean)) line(pen, [...seen, seen[0]], COLOURS.given, [], 1);
    else if (said.every(Boolean)) line(pen, [...said, said[0]], COLOURS.predicted, [5, 4], 1);
    seen.forEach((at, corner) => {
      if (!at && said[corner]) ring(pen, said[corner], COLOURS.predicted, 6, [3, 3]);
      if (at && !own) cross(pen, at, COLOURS.given, 6, 2);
    });
    pen.globalAlpha = 1;
    if (own) drawCorners(pen, view, seen, said);
  });
}

function drawCorners(pen, view, seen, said) {
  const here = view.index === state.active.camera;
  seen.forEach((at, corner) => {
    const active = here && corner === state.active.corner;
    const colour = active ? COLOURS.active : COLOURS.given;
    const off = residual(view.index, corner);
    if (at) {
      cross(pen, at, colour);
      if (active) ring(pen, at, colour, 13);
      label(pen, `${corner + 1}${off === null ? "" : ` · ${off.toFixed(1)}`}`, at, colour);
    } else if (said[corner]) {
      label(pen, `${corner + 1}?`, said[corner], COLOURS.predicted);
    }
  });
  if (here && cursor && !given()) {
    cross(pen, toScreen(view, cursor), COLOURS.active, 14, 4);
    label(pen, `${state.active.corner + 1}`, toScreen(view, cursor), COLOURS.active);
  }
  if (snapped && snapped.camera === view.index && snapped.rectangle === state.active.rectangle) {
    line(pen, [toScreen(view, snapped.from), toScreen(view, snapped.to)], "#fff", [], 1);
    ring(pen, toScreen(view, snapped.from), "#fff", 3);
  }
}

function drawMagnifier() {
  const canvas = byId("magnifier");
  const pen = context(canvas);
  const view = views[hover ? hover.camera : state.active.camera];
  const at = hover ? [hover.x, hover.y] : cursor;
  if (!view?.picture || !at) return;
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  drawPicture(pen, view, MAGNIFIED, at, width, height);
  const inside = (pixel) => [(pixel[0] - at[0]) * MAGNIFIED + width / 2, (pixel[1] - at[1]) * MAGNIFIED + height / 2];
  pixelsOf(view.index).forEach((pixel) => pixel && cross(pen, inside(pixel), COLOURS.given, 16, 5));
  predictedOf(view.index).forEach((pixel) => pixel && ring(pen, inside(pixel), COLOURS.predicted, 8, [3, 3]));
  if (snapped && snapped.camera === view.index) {
    line(pen, [inside(snapped.from), inside(snapped.to)], "#fff", [], 1);
    ring(pen, inside(snapped.from), "#fff", 4);
  }
  cross(pen, [width / 2, height / 2], COLOURS.active, 40, 6);
  byId("place").textContent = `${camera(view.index).name}: ${at[0].toFixed(1)}, ${at[1].toFixed(1)} px`
    + (hover ? "" : given() ? "" : ", Enter places it here");
}

function drawPanel() {
  const { camera: index, corner: active } = state.active;
  const table = tableOf(index);
  const sigma = table?.sigma ?? 1;
  byId("active-title").textContent = `${rectangle().name} in ${camera().name}`;
  const rows = state.corner_names.map((name, corner) => {
    const [pixel, off] = [pixelsOf(index)[corner], residual(index, corner)];
    const row = document.createElement("tr");
    row.className = corner === active ? "active" : "";
    row.onclick = () => activate({ corner });
    const cells = [`${corner + 1} ${name}`, pixel ? `${pixel[0].toFixed(1)}, ${pixel[1].toFixed(1)}` : "—",
      off === null ? "" : off.toFixed(2)];
    cells.forEach((text, k) => {
      const cell = row.insertCell();
      cell.textContent = text;
      if (k === 2 && off > FAR * sigma) cell.className = "far";
    });
    return row;
  });
  byId("corners").replaceChildren(...rows);
  if (document.activeElement !== byId("sigma")) byId("sigma").value = sigma;
  byId("sigma").disabled = !table;
  document.querySelector('[data-do="undo"]').disabled = !state.can_undo;
  document.querySelector('[data-do="redo"]').disabled = !state.can_redo;
  document.querySelectorAll('[data-do="snap"], [data-do="remove"]').forEach((one) => { one.disabled = !given(); });
  if (table?.problem) say(table.problem);
  drawPlan();
}

function drawPlan() {
  const { width, height } = rectangle();
  const scale = Math.min(130 / width, 90 / height);
  const [w, h] = [width * scale / 2, height * scale / 2];
  const make = (tag, attributes, text) => {
    const node = document.createElementNS("http://www.w3.org/2000/svg", tag);
    Object.entries(attributes).forEach(([name, value]) => node.setAttribute(name, value));
    if (text) node.textContent = text;
    return node;
  };
  const parts = [make("rect", { x: -w, y: -h, width: 2 * w, height: 2 * h }),
    make("text", { x: 0, y: h + 22, "text-anchor": "middle" }, `${width} m`),
    make("text", { x: w + 14, y: 4 }, `${height} m`)];
  [[w, h], [-w, h], [-w, -h], [w, -h]].forEach(([x, y], corner) => {
    const classes = [pixelsOf(state.active.camera)[corner] ? "given" : "", corner === state.active.corner ? "active" : ""];
    const dot = make("circle", { cx: x, cy: y, r: 6, class: classes.join(" ") });
    dot.onclick = () => activate({ corner });
    parts.push(dot, make("text", { x: x + Math.sign(x) * 13, y: y + Math.sign(y) * 12 + 4, "text-anchor": "middle" }, corner + 1));
  });
  byId("plan").replaceChildren(...parts);
}

function drawHeader() {
  const count = (one) => state.cameras.reduce((sum, _, index) => sum + pixelsOf(index, one).filter(Boolean).length, 0);
  [...byId("rectangles").children].forEach((button, index) => {
    const [have, all] = [count(state.rectangles[index]), 4 * state.cameras.length];
    button.setAttribute("aria-selected", index === state.active.rectangle);
    button.classList.toggle("full", have === all);
    button.querySelector("small").textContent = `${have}/${all}`;
  });
  byId("instant").hidden = state.images.length < 2;
  byId("instant-text").textContent = `${state.frameset + 1} of ${state.images.length}`;
  if (!state.status) return;
  byId("headline").textContent = state.status.headline;
  byId("headline").className = state.status.whole ? "rig" : "";
  byId("details").replaceChildren(...state.status.details.map((text) => {
    const item = document.createElement("li");
    item.textContent = text;
    return item;
  }));
}

let waiting = false;
function draw() {
  if (waiting) return;
  waiting = true;
  requestAnimationFrame(() => {
    waiting = false;
    views.forEach((view) => {
      view.figure.classList.toggle("active", view.index === state.active.camera);
      const have = pixelsOf(view.index).filter(Boolean).length;
      const worst = Math.max(...[0, 1, 2, 3].map((corner) => residual(view.index, corner) ?? -1));
      view.note.textContent = `${have} of 4 corners${worst < 0 ? "" : `, at most ${worst.toFixed(1)} px off`}`;
      if (view.canvas.clientWidth) drawView(view);
    });
    drawMagnifier();
    drawPanel();
    drawHeader();
  });
}

function say(text) {
  byId("said").textContent = text;
}

// Mouse

function grabbed(view, event) {
  const box = view.canvas.getBoundingClientRect();
  const off = pixelsOf(view.index).map((pixel) => {
    if (!pixel) return Infinity;
    const [x, y] = toScreen(view, pixel);
    return Math.hypot(x - (event.clientX - box.left), y - (event.clientY - box.top));
  });
  const nearest = off.indexOf(Math.min(...off));
  return off[nearest] < GRAB ? nearest : null;
}

async function press(view, event) {
  if (event.button) return;
  tabWalks = false;
  await settle();
  const corner = grabbed(view, event);
  drag = { view, start: [event.clientX, event.clientY], middle: [...view.middle], corner, moved: false };
  view.canvas.setPointerCapture(event.pointerId);
  view.canvas.focus({ preventScroll: true });
  if (corner !== null) activate({ camera: view.index, corner });
  else if (view.index !== state.active.camera) enter({ camera: view.index });
}

function move(view, event) {
  const [x, y] = toPicture(view, event);
  hover = { camera: view.index, x, y };
  if (drag?.view === view) {
    const [dx, dy] = [event.clientX - drag.start[0], event.clientY - drag.start[1]];
    drag.moved ||= Math.hypot(dx, dy) > MOVED;
    if (drag.moved && drag.corner !== null) {
      tableOf(view.index).pixels[drag.corner] = [x, y];
    } else if (drag.moved) {
      view.middle = [drag.middle[0] - dx / view.scale, drag.middle[1] - dy / view.scale];
    }
    return draw();
  }
  drawMagnifier();
}

function release(view, event) {
  const held = drag;
  drag = null;
  if (!held || held.view !== view || (held.moved && held.corner === null)) return;
  if (!held.moved && held.corner !== null) return;
  place(...toPicture(view, event), { advance: held.corner === null });
}

// Keys

const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
const KEYS = {
  Enter: () => cursor && place(...cursor),
  s: COMMANDS.snap,
  Delete: COMMANDS.remove,
  Backspace: COMMANDS.remove,
  n: () => enter(turned("camera", state.cameras.length, 1)),
  p: () => enter(turned("camera", state.cameras.length, -1)),
  ".": COMMANDS.later,
  ",": COMMANDS.earlier,
  "+": () => zoom(views[state.active.camera], 1.5, cursor),
  "=": () => zoom(views[state.active.camera], 1.5, cursor),
  "-": () => zoom(views[state.active.camera], 1 / 1.5, cursor),
  0: () => { fit(views[state.active.camera]); draw(); },
  f: () => { byId("pictures").classList.toggle("alone"); arrange(); },
  "?": () => { byId("keys").open = !byId("keys").open; },
  Escape: () => { tabWalks = true; say("Tab walks over the buttons now; click a picture to go on with corners"); },
};

function keyed(event) {
  if (event.target.matches("input, summary") && event.key !== "Escape") return;
  const step = ARROWS[event.key];
  const button = event.target.matches("button");
  if (step) {
    const size = event.shiftKey ? 10 : event.altKey ? 0.1 : event.ctrlKey || event.metaKey ? 100 : 1;
    event.preventDefault();
    return nudge(step[0] * size, step[1] * size);
  }
  if (event.key === "Tab") {
    if (tabWalks) return;
    event.preventDefault();
    settle();
    return activate(turned("corner", 4, event.shiftKey ? -1 : 1));
  }
  if (button && (event.key === "Enter" || event.key === " ")) return;
  const control = event.ctrlKey || event.metaKey;
  const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
  let act = control || event.altKey ? null : KEYS[key];
  if ((key === "u" && !control && !event.altKey) || (key === "z" && control)) act = event.shiftKey ? COMMANDS.redo : COMMANDS.undo;
  if (key === "y" && control) act = COMMANDS.redo;
  if (key === "r" && !control && !event.altKey) act = () => enter(turned("rectangle", state.rectangles.length, event.shiftKey ? -1 : 1));
  if (!act) return;
  event.preventDefault();
  settle().then(act);
}

// The page

function makeView(one, index) {
  const figure = document.createElement("figure");
  const canvas = document.createElement("canvas");
  const caption = document.createElement("figcaption");
  const [name, note] = [document.createElement("b"), document.createElement("span")];
  canvas.tabIndex = 0;
  canvas.style.aspectRatio = `${one.width} / ${one.height}`;
  canvas.setAttribute("aria-label", `Picture of ${one.name}`);
  name.textContent = one.name;
  caption.append(name, note);
  figure.append(canvas, caption);
  byId("pictures").append(figure);
  const view = { index, figure, canvas, note, picture: null, shown: null, scale: 1, middle: [0, 0] };
  canvas.onpointerdown = (event) => press(view, event);
  canvas.onpointermove = (event) => move(view, event);
  canvas.onpointerup = (event) => release(view, event);
  canvas.onpointerleave = () => { hover = null; drawMagnifier(); };
  canvas.onfocus = () => { if (state.active.camera !== index && !drag) enter({ camera: index }); };
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoom(view, Math.exp(-event.deltaY / 400), toPicture(view, event));
  }, { passive: false });
  new ResizeObserver(() => { fit(view); draw(); }).observe(canvas);
  return view;
}

async function begin() {
  const answer = await ask("session");
  if (!answer) return;
  Object.assign(state, answer);
  byId("path").textContent = `Kept in ${answer.path}`;
  // The first instant that every camera has a picture of.
  state.frameset = Math.max(state.images.findIndex((row) => row.every((one) => one >= 0)), 0);
  state.rectangles.forEach((one, rectangle) => {
    const button = document.createElement("button");
    button.role = "tab";
    button.append(one.name, document.createElement("small"));
    button.onclick = () => enter({ rectangle });
    byId("rectangles").append(button);
  });
  views.push(...state.cameras.map(makeView));
  arrange();
  window.addEventListener("resize", arrange);
  document.querySelectorAll("[data-do]").forEach((button) => {
    button.onclick = () => settle().then(COMMANDS[button.dataset.do]);
  });
  byId("sigma").onchange = (event) => change({ do: "sigma", ...about(), sigma: Number(event.target.value) });
  document.addEventListener("keydown", keyed);
  await Promise.all(views.map(load));
  views.forEach(fit);
  const first = state.cameras.findIndex((_, index) => pixelsOf(index).some((pixel) => !pixel));
  const camera = Math.max(first, 0);
  activate({ camera, corner: Math.max(pixelsOf(camera).findIndex((pixel) => !pixel), 0) });
  views[camera].canvas.focus({ preventScroll: true });
  solve();
}

begin();
