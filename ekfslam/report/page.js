"use strict";

// Tables that sort: every heading becomes a button.
for (const table of document.querySelectorAll("table.sorts")) {
  const headings = [...table.tHead.rows[0].cells];
  if (table.closest("details")) { // printed row by row, each number with its name
    const names = headings.map((heading) => heading.textContent);
    for (const row of table.tBodies[0].rows) {
      [...row.cells].forEach((cell, column) => (cell.dataset.name = names[column]));
    }
  }
  headings.forEach((heading, column) => {
    const button = document.createElement("button");
    button.type = "button";
    button.append(...heading.childNodes);
    heading.append(button);
    button.addEventListener("click", () => {
      const down = heading.getAttribute("aria-sort") === "ascending";
      for (const other of headings) other.removeAttribute("aria-sort");
      heading.setAttribute("aria-sort", down ? "descending" : "ascending");
      sortRows(table.tBodies[0], column, heading.classList.contains("number"), down ? -1 : 1);
    });
  });
}

function sortRows(body, column, numeric, sign) {
  const key = (row) => {
    const cell = row.cells[column];
    if (!numeric) return cell.textContent;
    return cell.dataset.value ? Number(cell.dataset.value.replace("inf", "Infinity")) : NaN;
  };
  const missing = (value) => value === "" || Number.isNaN(value);
  const order = (a, b) => (numeric ? a - b : a.localeCompare(b, "en", { numeric: true })) || 0;
  const rows = [...body.rows].map((row) => [key(row), row]);
  rows.sort(([a], [b]) => missing(a) - missing(b) || (missing(a) ? 0 : sign * order(a, b)));
  body.append(...rows.map(([, row]) => row));
}

// In print everything is open.
const printing = matchMedia("print");
const opened = new Set();
function open_all(yes) {
  for (const part of document.querySelectorAll("details")) {
    if (yes && !part.open) opened.add(part);
    if (yes || opened.has(part)) part.open = yes;
  }
  if (!yes) opened.clear();
}
printing.addEventListener("change", () => open_all(printing.matches));
addEventListener("beforeprint", () => open_all(true));
addEventListener("afterprint", () => open_all(false));

// Maps ---------------------------------------------------------------------------------------

const DASHES = { "-": "", "--": "7 4", "-.": "7 3 1 3", ":": "1.5 3" };
const KINDS = ["truth", "landmarks", "landmark ellipses", "pose ellipses", "sightings"];
const still = matchMedia("(prefers-reduced-motion: reduce)");

function made(name, attributes = {}, ...children) {
  const node = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
  node.append(...children);
  return node;
}

function drawn(name, attributes = {}, ...children) {
  const node = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
  node.append(...children);
  return node;
}

// The pieces of a path up to each stop; it breaks where a position is not known.
function pieces(xy) {
  const found = [];
  for (let i = 0; i < xy.length; i += 2) {
    const known = xy[i] !== null;
    const lone = i === 0 || xy[i - 2] === null;
    found.push(known ? `${lone ? "M" : "L"}${xy[i]} ${xy[i + 1]}${lone ? "h0" : ""}` : "");
  }
  return found;
}

const dots = (xy) => {
  let path = "";
  for (let i = 0; i < xy.length; i += 2) if (xy[i] !== null) path += `M${xy[i]} ${xy[i + 1]}h0`;
  return path;
};

function outline(x, y, a, b, deg) {
  const turn = (deg * Math.PI) / 180;
  const [u, v] = [a * Math.cos(turn), a * Math.sin(turn)];
  const arc = `A${a} ${b} ${deg} 0 1`;
  return `M${x - u} ${y - v}${arc} ${x + u} ${y + v}${arc} ${x - u} ${y - v}Z`;
}

function outlines(ellipses) {
  let path = "";
  for (let i = 0; i < ellipses.length; i += 5) path += outline(...ellipses.slice(i, i + 5));
  return path;
}

const few = (value) => (value === null ? "" : String(Number(value.toPrecision(3))));

class RunMap {
  constructor(section) {
    this.section = section;
    this.data = JSON.parse(section.querySelector("script").textContent);
    this.title = section.querySelector("h3").textContent;
    this.zoom = 1;
    this.center = this.data.size.map((side) => side / 2);
    this.at = this.data.steps.length - 1;
    this.layers = new Map(); // checkboxes: of series by number, of kinds by name
    this.timer = null;
    this.draw();
    this.controls();
    this.listen();
    this.show();
    this.look();
  }

  // Two pictures, one over the other: stepping through time does not redraw the ground.
  draw() {
    const { size, tracks, maps, truth, marks } = this.data;
    this.stage = made("div", { class: "stage", tabindex: "0", role: "group" });
    this.stage.setAttribute("aria-label", `View of ${this.title}: plus and minus zoom, arrows move`);
    this.stage.style.aspectRatio = `${size[0]} / ${Math.max(size[1], size[0] / 4)}`;
    this.ground = drawn("svg", { role: "img" });
    this.ground.setAttribute("aria-label", `Map of ${this.title}; the list below it says where each is`);
    this.moving = drawn("svg", { "aria-hidden": "true" });
    this.grid = drawn("g", { class: "grid" });
    this.ground.append(this.grid);
    maps.forEach((map, series) => {
      const stroke = `var(--c${map.color})`;
      const many = map.xy.length > 2000 ? " many" : "";
      const of = { "data-series": series, stroke };
      this.ground.append(
        drawn("path", { ...of, "data-kind": "landmarks", class: `landmarks${many}`, d: dots(map.xy) }),
        drawn("path", { ...of, "data-kind": "landmark ellipses", class: "ellipses", d: outlines(map.ellipses) }),
      );
    });
    if (marks.length) {
      this.ground.append(drawn("path", { "data-kind": "truth", class: "marks" }));
      this.marks = this.ground.lastChild;
    }
    this.tracks = tracks.map((track) => {
      const of = { "data-series": track.map, stroke: `var(--c${track.color})` };
      of["stroke-dasharray"] = DASHES[track.dash];
      const parts = pieces(track.xy);
      this.ground.append(drawn("path", { ...of, class: "ahead", d: parts.join("") }));
      const travelled = drawn("path", { ...of, class: "travelled" });
      const seen = drawn("path", { "data-series": track.map, "data-kind": "sightings", class: "seen", stroke: of.stroke });
      const ellipse = drawn("path", { "data-series": track.map, "data-kind": "pose ellipses", class: "ellipse", stroke: of.stroke });
      const pose = drawn("path", { "data-series": track.map, class: "pose", d: "M10 0L-6 6L-6 -6Z" });
      pose.style.fill = of.stroke;
      this.moving.append(seen, travelled, ellipse, pose);
      return { track, parts, travelled, seen, ellipse, pose };
    });
    this.truths = truth.map((track) => {
      const parts = pieces(track.xy);
      const thin = drawn("path", { "data-kind": "truth", class: "truth ahead", d: parts.join("") });
      this.ground.append(thin);
      const travelled = drawn("path", { "data-kind": "truth", class: "truth travelled" });
      travelled.style.strokeWidth = "1";
      this.moving.append(travelled);
      return { parts, travelled };
    });
    this.stage.append(this.ground, this.moving);
    this.section.append(this.stage);
  }

  controls() {
    const last = this.data.steps.length - 1;
    const button = (text, label, act) => {
      const node = made("button", { type: "button" }, text);
      if (label) node.setAttribute("aria-label", label);
      node.addEventListener("click", act);
      return node;
    };
    this.play = button("Play", "", () => (this.timer ? this.stop() : this.start()));
    this.slider = made("input", { type: "range", min: 0, max: last, value: last });
    this.slider.addEventListener("input", () => this.go(Number(this.slider.value)));
    const follow = this.box("Follow", false, () => this.look());
    this.follow = follow.firstChild;
    follow.style.flex = "none";
    this.section.append(
      made("div", { class: "controls" }, this.play, made("label", {}, "Time", this.slider)),
      made("div", { class: "controls" },
        button("−", "Zoom out", () => this.scale(0.5)),
        button("+", "Zoom in", () => this.scale(2)),
        button("Whole map", "", () => this.scale(0)),
        follow),
    );
    this.series = made("fieldset", {}, made("legend", {}, "Estimators"));
    this.data.maps.forEach((map, series) => {
      const box = this.box(map.label, map.on, () => this.switch());
      const line = { d: "M1 6H31", stroke: `var(--c${map.color})`, "stroke-width": 2.5, "stroke-dasharray": DASHES[map.dash] };
      box.insertBefore(drawn("svg", { viewBox: "0 0 32 12", "aria-hidden": "true" }, drawn("path", line)), box.lastChild);
      this.layers.set(series, box.firstChild);
      this.series.append(box);
    });
    const kinds = made("fieldset", {}, made("legend", {}, "Layers"));
    for (const kind of KINDS) {
      if (!this.section.querySelector(`[data-kind="${kind}"]`)) continue;
      if (kind === "sightings" && !this.data.sightings.length) continue;
      const box = this.box(kind, true, () => this.switch());
      this.layers.set(kind, box.firstChild);
      kinds.append(box);
    }
    this.readout = made("div", { class: "readout", role: "status" });
    this.section.append(this.series, kinds, this.readout);
  }

  box(text, checked, act) {
    const input = made("input", { type: "checkbox" });
    input.checked = checked;
    input.addEventListener("change", act);
    return made("label", {}, input, made("span", {}, text));
  }

  listen() {
    new ResizeObserver(() => this.look()).observe(this.stage);
    this.stage.addEventListener("keydown", (event) => {
      const moves = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
      if (event.key === "+" || event.key === "=") this.scale(2);
      else if (event.key === "-") this.scale(0.5);
      else if (moves[event.key] && this.zoom > 1) this.move(...moves[event.key].map((m) => (m * this.span) / 8));
      else return;
      event.preventDefault();
    });
    let held = null;
    this.stage.addEventListener("pointerdown", (event) => {
      if (this.zoom > 1) held = [event.clientX, event.clientY];
    });
    addEventListener("pointerup", () => (held = null));
    this.stage.addEventListener("pointermove", (event) => {
      if (!held) return;
      this.move((held[0] - event.clientX) * this.pixel, (held[1] - event.clientY) * this.pixel);
      held = [event.clientX, event.clientY];
    });
  }

  // Time

  start() {
    const last = this.data.steps.length - 1;
    if (this.at === last) this.go(0);
    // Who asks for less motion gets ten still pictures.
    const [pause, stride] = still.matches ? [1000, last / 10] : [50, last / 240];
    const step = Math.max(1, Math.round(stride));
    this.play.textContent = "Pause";
    this.readout.setAttribute("aria-live", "off");
    this.timer = setInterval(() => {
      this.go(Math.min(this.at + step, last));
      if (this.at === last) this.stop();
    }, pause);
  }

  stop() {
    clearInterval(this.timer);
    this.timer = null;
    this.play.textContent = "Play";
    this.readout.removeAttribute("aria-live");
  }

  go(at) {
    document.body.classList.add("stepping");
    clearTimeout(this.rest);
    this.rest = setTimeout(() => document.body.classList.remove("stepping"), 2000);
    this.at = at;
    this.slider.value = at;
    this.show();
    if (this.follow.checked) this.look();
  }

  show() {
    const { at, data } = this;
    const time = data.times[at] === null ? "" : `, ${few(data.times[at])} s`;
    const when = `step ${data.steps[at]} of ${data.steps.at(-1)}${time}`;
    this.slider.setAttribute("aria-valuetext", when);
    const told = [];
    this.tracks.forEach(({ track, parts, travelled, seen, ellipse, pose }, number) => {
      const [x, y] = track.xy.slice(2 * at, 2 * at + 2);
      const [a, b, deg] = track.ellipses.slice(3 * at, 3 * at + 3);
      const known = x !== null;
      const sized = known && a !== undefined && a !== null;
      travelled.setAttribute("d", parts.slice(0, at + 1).join(""));
      ellipse.setAttribute("d", sized && a > 0 ? outline(x, y, a, b, deg) : "");
      pose.classList.toggle("nowhere", !known);
      pose.dataset.at = known ? `${x} ${y} ${track.deg[at] ?? 0}` : "";
      const landmarks = (known && data.sightings[number]?.[at]) || [];
      const xy = data.maps[track.map].xy;
      const rays = landmarks.filter((i) => xy[2 * i] !== null);
      seen.setAttribute("d", rays.map((i) => `M${x} ${y}L${xy[2 * i]} ${xy[2 * i + 1]}`).join(""));
      if (!this.on(track.map)) return;
      const words = [];
      if (track.error[at] !== null) words.push(`${few(track.error[at])} m off the truth`);
      if (sized) words.push(`3σ up to ${few(a / data.unit)} m`);
      if (rays.length) words.push(`${rays.length} ${rays.length === 1 ? "landmark" : "landmarks"} seen`);
      const whose = track.robot ? `, ${track.robot}` : "";
      told.push(`${track.label}${whose}: ${known ? words.join(", ") || "pose known" : "not known or far outside"}`);
    });
    for (const { parts, travelled } of this.truths) travelled.setAttribute("d", parts.slice(0, at + 1).join(""));
    this.readout.replaceChildren(made("strong", {}, `${when[0].toUpperCase()}${when.slice(1)}`), made("ul", {}, ...told.map((words) => made("li", {}, words))));
    this.place();
  }

  // Layers

  on(series) {
    return this.layers.get(series)?.checked ?? this.data.maps[series].on;
  }

  switch() {
    for (const node of this.section.querySelectorAll(".stage [data-series], .stage [data-kind]")) {
      const { series, kind } = node.dataset;
      const off = (series !== undefined && !this.on(Number(series))) || (kind && this.layers.get(kind)?.checked === false);
      node.classList.toggle("off", Boolean(off));
    }
    for (const box of this.layers.values()) box.parentNode.classList.toggle("off-layer", !box.checked);
    this.show();
  }

  // View

  scale(factor) {
    this.zoom = factor ? Math.min(Math.max(this.zoom * factor, 1), 256) : 1;
    if (this.zoom === 1) this.center = this.data.size.map((side) => side / 2);
    this.look();
  }

  move(x, y) {
    this.follow.checked = false;
    this.center = [this.center[0] + x, this.center[1] + y];
    this.look();
  }

  look() {
    const [width, height] = [this.stage.clientWidth, this.stage.clientHeight];
    if (!width || !height) return;
    const [w, h] = this.data.size;
    if (this.follow.checked && this.zoom > 1) {
      const seen = this.tracks.find(({ track }) => this.on(track.map) && track.xy[2 * this.at] !== null);
      if (seen) this.center = seen.track.xy.slice(2 * this.at, 2 * this.at + 2);
    }
    this.pixel = Math.max(w / width, h / height) / this.zoom; // units
    const [dx, dy] = [width * this.pixel, height * this.pixel];
    this.span = Math.min(dx, dy);
    const [left, top] = [this.center[0] - dx / 2, this.center[1] - dy / 2];
    for (const picture of [this.ground, this.moving]) picture.setAttribute("viewBox", `${left} ${top} ${dx} ${dy}`);
    this.stage.classList.toggle("near", this.zoom > 1);
    this.rule(left, top, dx, dy);
    if (this.marks) {
      const { marks } = this.data;
      const arm = (marks.length > 2000 ? 2 : 4) * this.pixel;
      let path = "";
      for (let i = 0; i < marks.length; i += 2) path += `M${marks[i] - arm} ${marks[i + 1]}h${2 * arm}m${-arm} ${-arm}v${2 * arm}`;
      this.marks.setAttribute("d", path);
    }
    this.place();
  }

  place() {
    if (!this.pixel) return;
    for (const { pose } of this.tracks) {
      const [x, y, deg] = pose.dataset.at.split(" ");
      pose.style.display = x ? "" : "none";
      if (x) pose.setAttribute("transform", `translate(${x} ${y}) rotate(${deg}) scale(${this.pixel})`);
    }
  }

  // Lines of the grid with what they are in metres
  rule(left, top, dx, dy) {
    const { origin, unit } = this.data;
    const least = (90 * this.pixel) / unit; // between two lines [m]
    const decade = 10 ** Math.floor(Math.log10(least));
    const metres = [1, 2, 5, 10].map((m) => m * decade).find((m) => m >= least);
    const parts = [];
    const size = 11 * this.pixel;
    const write = (x, y, text) => parts.push(drawn("text", { x, y, "font-size": size }, text));
    const places = Math.max(0, -Math.floor(Math.log10(metres)));
    for (let m = Math.ceil((origin[0] + left / unit) / metres) * metres; (m - origin[0]) * unit < left + dx; m += metres) {
      const x = (m - origin[0]) * unit;
      parts.push(drawn("line", { x1: x, x2: x, y1: top, y2: top + dy }));
      write(x + 3 * this.pixel, top + dy - 4 * this.pixel, `${m.toFixed(places)} m`);
    }
    for (let m = Math.ceil((origin[1] - (top + dy) / unit) / metres) * metres; (origin[1] - m) * unit > top; m += metres) {
      const y = (origin[1] - m) * unit;
      parts.push(drawn("line", { y1: y, y2: y, x1: left, x2: left + dx }));
      if (y < top + dy - 20 * this.pixel) write(left + 3 * this.pixel, y - 3 * this.pixel, `${m.toFixed(places)} m`);
    }
    this.grid.replaceChildren(...parts);
  }
}

for (const section of document.querySelectorAll("div.map")) {
  const map = new RunMap(section);
  map.switch();
}
