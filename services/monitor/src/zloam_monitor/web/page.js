"use strict";
// Fetches once a second the state of the chosen robot, and its map if that has changed.

const COLOURS = ["#2f7fd6", "#d6702f", "#2fa36b", "#a24fc4", "#c4a02f", "#c43f5f"];
const GOOD = ["ok", "ready"];
const OLD_S = 2;
// A cell whose points are within this height range is ground, and drawn lighter.
const GROUND_DM = 5;
const BAD = ["failed", "silent", "lost", "invalid"];
// Over a link that was cut a browser waits minutes for an answer, and would show an old state as the current one.
let stateMs = 10000;
// The map may take long over a slow link.
const MAP_MS = 120000;
const byId = (id) => document.getElementById(id);

let robots = [];
let chosen = null;
let state = null;
let map = noMap();
// Ends what is under way for the robot that was chosen before.
let asking = new AbortController();
let timer = null;
// The signal of the request for a map that is under way.
let mapAsked = null;
let view = { x: 0, y: 0, scale: 8, follow: true };

function noMap() {
  return { version: -1, cells: new Int16Array(), cell_m: 1, origin: [0, 0] };
}

const kindOf = (health) => (GOOD.includes(health) ? "good" : BAD.includes(health) ? "bad" : "warn");

async function asked(path, signal, patienceMs) {
  const late = new AbortController();
  const end = () => late.abort();
  const ends = setTimeout(end, patienceMs);
  signal.addEventListener("abort", end);
  try {
    const answer = await fetch(path, { cache: "no-store", signal: late.signal });
    if (!answer.ok) throw new Error(`${path}: ${answer.status}`);
    const said = await answer.json();
    signal.throwIfAborted();
    return said;
  } finally {
    clearTimeout(ends);
    signal.removeEventListener("abort", end);
  }
}

function element(name, text, className) {
  const made = document.createElement(name);
  if (text !== undefined) made.textContent = text;
  if (className) made.className = className;
  return made;
}

function choose(name) {
  asking.abort();
  clearTimeout(timer);
  asking = new AbortController();
  chosen = name;
  state = null;
  map = noMap();
  view.follow = true;
  showRobots();
  clear();
  lookAgain(asking.signal);
}

// Nothing of the robot that was chosen before may be taken for a state of this one, whose answer may take long.
function clear() {
  for (const id of ["health", "position", "heading", "sigma", "rate", "sweep"]) byId(id).textContent = "–";
  byId("health").className = "pill";
  for (const id of ["stages", "findings", "legend", "scale"]) byId(id).replaceChildren();
  for (const id of ["map", "latency"]) prepared(byId(id));
  byId("connection").textContent = "connecting";
  byId("connection").className = "";
}

function showRobots() {
  const tabs = robots.map((name) => {
    const tab = element("button", name);
    tab.type = "button";
    tab.setAttribute("role", "tab");
    tab.setAttribute("aria-selected", String(name === chosen));
    tab.addEventListener("click", () => choose(name));
    return tab;
  });
  const focused = byId("robots").contains(document.activeElement);
  byId("robots").replaceChildren(...tabs);
  if (focused) tabs[robots.indexOf(chosen)]?.focus();
}

// Looks until another robot is chosen, a second after the answers to the look before.
async function lookAgain(signal) {
  await look(signal);
  if (!signal.aborted) timer = setTimeout(() => lookAgain(signal), 1000);
}

async function look(signal) {
  try {
    const found = await asked("robots.json", signal, stateMs);
    if (String(found.robots) !== String(robots)) {
      robots = found.robots;
      if (!robots.includes(chosen)) return choose(robots[0] ?? null);
      showRobots();
    }
    if (chosen !== null) {
      const path = `robots/${encodeURIComponent(chosen)}`;
      state = await asked(`${path}/state.json`, signal, stateMs);
      if (state.map_version !== map.version && mapAsked !== signal) askForMap(`${path}/map.json`, signal);
    }
    const taken = state && state.kb_s !== null ? `; this view takes ${state.kb_s.toFixed(1)} kB/s` : "";
    byId("connection").textContent = `connected, zloam ${found.version}${taken}`;
    byId("connection").className = "";
  } catch (error) {
    if (signal.aborted) return;
    byId("connection").textContent = "no connection: what is shown is old";
    byId("connection").className = "lost";
  }
  show();
}

// The next looks don't wait for the map, which may take long over a slow link.
async function askForMap(path, signal) {
  mapAsked = signal;
  try {
    map = unpacked(await asked(path, signal, MAP_MS));
    show();
  } catch (error) {
    // The next look says that the connection is lost, or asks for the map again.
  } finally {
    if (mapAsked === signal) mapAsked = null;
  }
}

function unpacked(said) {
  const bytes = Uint8Array.from(atob(said.cells), (c) => c.charCodeAt(0));
  return { ...said, cells: new Int16Array(bytes.buffer) };
}

function show() {
  if (!state) return;
  showPose();
  showStages();
  showFindings();
  drawMap();
  drawLatency();
}

function showPose() {
  const pose = state.pose;
  const old = pose && state.age_s > OLD_S;
  const said = pose ? (pose.degenerate && pose.health === "ok" ? "degenerate" : pose.health) : "no pose yet";
  byId("health").textContent = old ? `no new pose for ${state.age_s.toFixed(0)} s` : said;
  byId("health").className = `pill ${old ? "bad" : kindOf(said)}`;
  byId("position").textContent = pose ? pose.xyz.map((v) => v.toFixed(2)).join("  ") + " m" : "–";
  byId("heading").textContent = pose ? `${pose.yaw_deg.toFixed(1)}°` : "–";
  byId("sigma").textContent = pose && pose.sigma_m !== null ? `${(1000 * pose.sigma_m).toFixed(1)} mm` : "–";
  byId("rate").textContent = state.rate ? `${state.rate.toFixed(1)} /s` : "–";
  byId("sweep").textContent = pose ? pose.sweep : "–";
}

function showStages() {
  const rows = (state.stages ?? []).map((stage) => {
    const row = element("tr");
    const name = element("th", stage.name);
    name.scope = "row";
    name.title = stage.about;
    const health = element("td");
    health.append(element("span", stage.health, kindOf(stage.health)));
    if (stage.reason) health.append(element("small", stage.reason));
    const dropped = Object.entries(stage.dropped ?? {}).map(([why, n]) => `${n} ${why}`);
    row.append(name, health, element("td", stage.queued ?? "–"), element("td", dropped.join(", ") || "0"),
      element("td", stage.memory_mib ?? "–"), element("td", stage.cpu_s ?? "–"));
    return row;
  });
  byId("stages").replaceChildren(...rows);
}

function showFindings() {
  const found = (state.findings ?? []).map((each) => {
    const item = element("li");
    item.append(element("span", each.what, each.fault ? "bad" : "warn"), element("small", each.do));
    return item;
  });
  const nothing = state.judged ? "all well" : "listening";
  byId("findings").replaceChildren(...(found.length ? found : [element("li", nothing, state.judged ? "good" : "")]));
}

function prepared(canvas) {
  const ratio = window.devicePixelRatio || 1;
  const width = canvas.clientWidth, height = canvas.clientHeight;
  canvas.width = Math.round(width * ratio);
  canvas.height = Math.round(height * ratio);
  const to = canvas.getContext("2d");
  to.setTransform(ratio, 0, 0, ratio, 0, 0);
  return { to, width, height };
}

function drawMap() {
  const style = getComputedStyle(document.documentElement);
  const { to, width, height } = prepared(byId("map"));
  if (view.follow && state.pose) [view.x, view.y] = state.pose.xyz;
  const column = (x) => width / 2 + (x - view.x) * view.scale;
  const row = (y) => height / 2 - (y - view.y) * view.scale;
  const size = Math.max(1, map.cell_m * view.scale);
  const [ground, wall] = [style.getPropertyValue("--ground-cell"), style.getPropertyValue("--wall-cell")];
  for (let i = 0; i < map.cells.length; i += 3) {
    const x = Math.round(column((map.cells[i] + map.origin[0]) * map.cell_m));
    const y = Math.round(row((map.cells[i + 1] + map.origin[1] + 1) * map.cell_m));
    to.fillStyle = map.cells[i + 2] < GROUND_DM ? ground : wall;
    if (x > -size && x < width && y > -size && y < height) to.fillRect(x, y, Math.ceil(size), Math.ceil(size));
  }
  to.strokeStyle = style.getPropertyValue("--good");
  to.lineWidth = 2;
  to.beginPath();
  const path = state.path ?? [];
  path.forEach(([x, y]) => to.lineTo(column(x), row(y)));
  if (state.pose) to.lineTo(column(state.pose.xyz[0]), row(state.pose.xyz[1]));
  to.stroke();
  if (state.pose) drawRobot(to, column(state.pose.xyz[0]), row(state.pose.xyz[1]), style);
  byId("follow").setAttribute("aria-pressed", String(view.follow));
  byId("scale").textContent = `${(100 / view.scale).toPrecision(2)} m in 100 points, cells of ${map.cell_m} m`;
}

function drawRobot(to, x, y, style) {
  const yaw = (-state.pose.yaw_deg * Math.PI) / 180;
  to.save();
  to.translate(x, y);
  to.rotate(yaw);
  to.fillStyle = style.getPropertyValue("--bad");
  to.beginPath();
  to.moveTo(12, 0);
  to.lineTo(-7, 7);
  to.lineTo(-7, -7);
  to.closePath();
  to.fill();
  to.restore();
}

function drawLatency() {
  const style = getComputedStyle(document.documentElement);
  const { to, width, height } = prepared(byId("latency"));
  const history = state.history ?? [];
  const names = (state.stages ?? []).map((stage) => stage.name).filter((n) => history.some((h) => n in h.stages));
  const greatest = Math.max(1, ...history.flatMap((h) => Object.values(h.stages)));
  const left = 40, bottom = height - 20, top = 8;
  to.font = "12px system-ui, sans-serif";
  to.fillStyle = style.getPropertyValue("--quiet");
  to.strokeStyle = style.getPropertyValue("--line");
  for (const share of [0, 0.5, 1]) {
    const y = bottom - share * (bottom - top);
    to.fillText((share * greatest).toPrecision(2), 2, y + 4);
    to.beginPath();
    to.moveTo(left, y);
    to.lineTo(width, y);
    to.stroke();
  }
  to.fillText("2 min ago", left, height - 4);
  to.fillText("now", width - 28, height - 4);
  names.forEach((name, n) => {
    to.strokeStyle = COLOURS[n % COLOURS.length];
    to.lineWidth = 1.5;
    to.beginPath();
    history.forEach((h, i) => {
      if (!(name in h.stages)) return;
      const x = width - ((history.length - 1 - i) / 120) * (width - left);
      to.lineTo(x, bottom - (h.stages[name] / greatest) * (bottom - top));
    });
    to.stroke();
  });
  const legend = names.map((name, n) => {
    const item = element("li");
    const box = element("span");
    box.style.background = COLOURS[n % COLOURS.length];
    const last = history.length ? history[history.length - 1].stages[name] : undefined;
    item.append(box, `${name} ${last === undefined ? "–" : last.toFixed(1)}`);
    return item;
  });
  byId("legend").replaceChildren(...legend);
}

function moved(x, y) {
  view.follow = false;
  view.x += x;
  view.y += y;
  show();
}

function scaled(by) {
  view.scale = Math.min(200, Math.max(0.2, view.scale * by));
  show();
}

function follow() {
  view.follow = !view.follow;
  show();
}

function listenTo(canvas) {
  const step = () => 60 / view.scale;
  const keys = {
    ArrowLeft: () => moved(-step(), 0), ArrowRight: () => moved(step(), 0),
    ArrowUp: () => moved(0, step()), ArrowDown: () => moved(0, -step()),
    "+": () => scaled(1.25), "=": () => scaled(1.25), "-": () => scaled(0.8), f: follow,
  };
  canvas.addEventListener("keydown", (event) => {
    if (!keys[event.key] || event.ctrlKey || event.metaKey) return;
    event.preventDefault();
    keys[event.key]();
  });
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    scaled(event.deltaY < 0 ? 1.15 : 1 / 1.15);
  }, { passive: false });
  canvas.addEventListener("pointerdown", (event) => canvas.setPointerCapture(event.pointerId));
  canvas.addEventListener("pointermove", (event) => {
    if (canvas.hasPointerCapture(event.pointerId)) moved(-event.movementX / view.scale, event.movementY / view.scale);
  });
}

listenTo(byId("map"));
byId("nearer").addEventListener("click", () => scaled(1.25));
byId("farther").addEventListener("click", () => scaled(0.8));
byId("follow").addEventListener("click", follow);
window.addEventListener("resize", show);
lookAgain(asking.signal);
