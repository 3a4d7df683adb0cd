"use strict";
// The page shows the state of the server and sends what a person says. Texts of files are only ever put as text.

const byId = id => document.getElementById(id);
const EVERY = 400;  // ms between looks at a server that works
const LARGEST = 200e6, MOST = 5000;  // bytes of a file, and files in a folder; the server holds them as well
const GONE = "The server does not answer. It may have been ended in the terminal.";
const WORDS = { look: "Looking at the files", check: "Checking the job", calibrate: "Calibrating" };
let state = null, shown = {}, timer = 0, columns = {}, dirty = false, before = null, refused = [];

function element(tag, text, more = {}) {
  const made = Object.assign(document.createElement(tag), more);
  if (text !== undefined) made.textContent = text;
  return made;
}

// A value as a person reads it: a long number with six digits, a long word cut.
function short(word) {
  if (word.length <= 12) return word;
  return Number.isFinite(Number(word)) ? String(Number(Number(word).toPrecision(6))) : word.slice(0, 20);
}

// Draws a part of the page anew only where its part of the state has changed, and leaves the focus where it was.
function part(name, contents, draw) {
  const now = JSON.stringify(contents) ?? "";
  if (shown[name] === now) return;
  shown[name] = now;
  const focused = document.activeElement && document.activeElement.id;
  draw();
  if (focused && document.activeElement === document.body && byId(focused)) byId(focused).focus();
}

function list(id, sentences) {
  byId(id).replaceChildren(...sentences.map(sentence => element("li", sentence)));
}

function options(select, values, chosen) {
  select.replaceChildren(...values.map(([value, text]) => element("option", text, { value, selected: value === chosen })));
}

async function ask(method, path, body) {
  let answer;
  try {
    const response = await fetch(path, { method, body });
    answer = await response.json();
  } catch {
    answer = { sentence: GONE };
  }
  if (answer.files) state = answer;
  else byId("sentence").textContent = answer.sentence;
  return Boolean(answer.files);
}

async function refresh() {
  clearTimeout(timer);
  if (await ask("GET", "state")) draw();
  clearTimeout(timer);  // of another one that came meanwhile
  if (state && state.busy) timer = setTimeout(refresh, EVERY);
}

async function told(method, path, body) {
  const good = await ask(method, path, body);
  if (good) { draw(); await refresh(); }
  return good;
}

function answers() {
  const found = {};
  for (const select of document.querySelectorAll("[data-answer]")) if (select.value) found[select.dataset.answer] = select.value;
  if (Object.keys(columns).length) found.columns = columns;
  return found;
}

// Every change is followed by a look: that is the live check.
function look(more = {}) {
  const said = { robot: byId("robot").value, stack: byId("stack").checked, each_point: byId("points").checked, camera_on: byId("camera").value, answers: answers() };
  return told("POST", "look", JSON.stringify({ ...said, ...more }));
}

// Files with their paths: a dropped folder's, one below the other, or those of a chosen folder.
async function inside(entry, path, found) {
  if (found.length > MOST) return;
  if (entry.isFile) {
    found.push([path + entry.name, await new Promise((good, bad) => entry.file(good, bad))]);
    return;
  }
  const reader = entry.createReader();
  for (;;) {  // a reader gives some at a time, and none at the end
    const some = await new Promise((good, bad) => reader.readEntries(good, bad));
    if (!some.length) return;
    for (const one of some) await inside(one, path + entry.name + "/", found);
  }
}
async function dropped(transfer) {
  // Asked for at once: after the first wait the browser has forgotten them.
  const entries = [...transfer.items].map(item => item.webkitGetAsEntry && item.webkitGetAsEntry()).filter(Boolean);
  if (!entries.some(entry => entry.isDirectory)) return [...transfer.files].map(file => [file.name, file]);
  const found = [];
  for (const entry of entries) await inside(entry, "", found);
  return found;
}

async function take(files) {
  let good = false, taken = false, robot, wanted = {};
  refused = [];
  const response = await fetch("offer", { method: "POST", body: JSON.stringify({ paths: files.map(([path]) => path) }) })
    .then(answer => answer.json()).catch(() => ({ sentence: GONE }));
  if (response.wanted) [wanted, state, good] = [response.wanted, response, true];
  else byId("sentence").textContent = response.sentence;
  for (const [path, file] of files.filter(([path]) => Object.hasOwn(wanted, path))) {
    byId("status").textContent = `Taking ${path}`;
    if (file.size > LARGEST) byId("sentence").textContent = `${path}: is too large; a file may have ${LARGEST / 1e6} MB.`;
    else if (await ask("PUT", "files/" + encodeURIComponent(wanted[path]), file)) {
      [robot, taken] = [state.robot, true];
      continue;
    }
    // The others are taken all the same, unless it is for none of them.
    const sentence = byId("sentence").textContent, none = sentence === GONE || sentence === refused.at(-1);
    if (!none) refused.push(sentence);
    good = false;
    if (none) break;
  }
  byId("status").textContent = "";
  if (!state) return;
  const sentence = byId("sentence").textContent;
  if (!taken) refused = [];
  columns = {};
  draw();
  if ((good || taken) && sentence !== GONE && state.files.length) await look({ robot: robot ?? state.robot });
  else byId("sentence").textContent = sentence;
}

function draw() {
  const found = state.look, busy = state.busy, running = Boolean(busy) && busy.verb === "calibrate";
  part("files", state.files, () => {
    // A robot's meshes are many, and one thing.
    const meshes = state.files.filter(file => file.kind === "mesh"), others = state.files.filter(file => file.kind !== "mesh");
    const items = others.map(({ name, kind, size }) => [name, `${kind}, ${Math.ceil(size / 1000)} kB`, [name]]);
    if (meshes.length) {
      const size = meshes.reduce((sum, file) => sum + file.size, 0);
      items.push([meshes.length === 1 ? meshes[0].name : `${meshes.length} meshes`, `mesh, ${Math.ceil(size / 1000)} kB`, meshes.map(file => file.name)]);
    }
    byId("files").replaceChildren(...items.map(([text, what, names], k) => {
      const item = element("li"), button = element("button", "Remove", { type: "button", id: "remove-" + k });
      button.setAttribute("aria-label", "Remove " + text);
      button.addEventListener("click", async () => {
        let good = true;
        refused = [];
        for (const name of names) good = good && await ask("DELETE", "files/" + encodeURIComponent(name));
        draw();
        if (good && state.files.length) await look({ robot: state.robot });
        byId("choose").focus();
      });
      item.append(element("span", text), element("span", what, { className: "soft" }), button);
      return item;
    }));
    const kinds = kind => state.files.filter(file => file.kind === kind).length;
    byId("stack-label").hidden = kinds("table") < 2;
    byId("camera-label").hidden = !kinds("photograph");
  });
  part("robots", [state.files, state.robot, examples], () => {
    const robots = state.files.filter(file => file.kind === "robot").map(({ name }) => [name, name]);
    const known = examples.map(name => [name, name.split("/").pop().replace(".urdf", "") + " (example)"]);
    options(byId("robot"), [["", "choose one, or drop its URDF"], ...robots, ...known], state.robot);
  });
  part("asked", [state.stack, state.each_point, state.camera_on, state.answers], () => {
    byId("stack").checked = state.stack;
    byId("points").checked = state.each_point;
    byId("camera").value = state.camera_on;
    columns = { ...(state.answers.columns || {}) };
    for (const select of document.querySelectorAll("[data-answer]")) {
      const value = state.answers[select.dataset.answer] || "";
      if (value && select.options && ![...select.options].some(o => o.value === value)) select.append(element("option", value, { value }));
      select.value = value;
    }
    const named = Object.entries(columns).map(([ours, theirs]) => `${ours} is ${theirs}`).join("; ");
    byId("named").textContent = named && `Said so far: ${named}.`;
  });
  const left = [state.left_out, ...refused].filter(Boolean).join(" ");
  if (byId("left-out").textContent !== left) byId("left-out").textContent = left;
  part("sentence", state.sentence, () => { byId("sentence").textContent = state.sentence; });
  if (!state.sentence && (found || busy)) byId("sentence").textContent = "";

  const several = Boolean(found && found.question && found.question.about === "position");
  byId("points-label").hidden = !(state.each_point || several);

  // While a new look is under way, what the last one found stays to be seen; it is not to be calibrated.
  if (found || !busy) drawLook(found);
  for (const id of ["choose", "folder", "robot", "stack", "points", "camera", "check", "name", "forget"]) byId(id).disabled = running;
  for (const control of document.querySelectorAll("#grids select, [data-answer], #choices button, #files button")) control.disabled = running;
  byId("job").readOnly = running;
  byId("calibrate").disabled = Boolean(busy) || dirty || !(found && found.findings);
  byId("cancel").disabled = !busy;
  byId("progress").hidden = !busy;
  if (busy) {
    byId("bar").max = busy.of;
    byId("bar").value = busy.done;
    byId("seconds").textContent = `${busy.seconds} s`;
  }
  const status = busy ? `${WORDS[busy.verb]}: ${busy.step}, step ${Math.min(busy.done + 1, busy.of)} of ${busy.of}`
    : before === "calibrate" && !state.results && !state.sentence ? "Cancelled; nothing was written."
    : before ? ended() : byId("status").textContent;
  if (byId("status").textContent !== status) byId("status").textContent = status;
  drawResults();
  before = busy ? busy.verb : null;
}

function ended() {
  if (state.sentence) return "";
  if (state.look && state.look.question) return "A question is open.";
  if (state.results) return "Calibrated.";
  return state.look && state.look.findings ? "Ready to calibrate." : "";
}

function drawLook(found) {
  byId("reading").hidden = !found && !state.sentence;
  byId("checking").hidden = !(found && found.job);
  if (!found) {
    part("question", null, () => { byId("question").hidden = true; });
    part("grids", null, () => byId("grids").replaceChildren());
    part("why", null, () => list("why", []));
    byId("why-box").hidden = true;
    return;
  }
  part("why", found.reasons, () => list("why", found.reasons || []));
  byId("why-box").hidden = !(found.reasons || []).length;
  part("question", found.question, () => {
    const question = found.question;
    byId("question").hidden = !question;
    if (!question) return;
    byId("asked").textContent = question.text;
    byId("choices").replaceChildren(...question.choices.map(({ text, answers: given }, k) => {
      const button = element("button", text, { type: "button", id: "choice-" + k });
      button.addEventListener("click", () => {
        const all = answers();
        look({ answers: { ...all, ...given, columns: { ...columns, ...(given.columns || {}) } } });
      });
      return button;
    }));
    if (!question.choices.length) {
      byId("choices").replaceChildren(element("span", `It is answered by ${question.option.replaceAll("--", "")}.${byId("stack-label").hidden ? "" : " Or each table is one target: say so above."}`));
      byId("said").open = true;
    }
  });
  part("links", [found.links, found.tip], () => {
    options(byId("links"), (found.links || []).map(link => [link, link]));
    byId("tip").placeholder = found.tip || "as found";
  });
  part("grids", found.tables, () => drawGrids(found.tables || []));
  part("job", found.job, () => { byId("job").value = found.job || ""; dirty = false; });
  part("findings", [found.findings, found.sound], () => {
    list("findings", found.findings || []);
    byId("findings").className = found.sound ? "sound" : "";
  });
  byId("determined").textContent = found.determined || "";
  part("unseen", [found.unseen, found.directions], () => {
    list("unseen", found.unseen || []);
    byId("unseen-box").hidden = !(found.unseen || []).length;
    byId("unseen-title").textContent = found.directions === 1 ? "The null space has one direction"
      : `The null space has ${found.directions} directions`;
  });
}

function drawGrids(tables) {
  const all = [...new Set(tables.flatMap(table => Object.keys(table.columns)))];
  options(byId("theirs"), all.map(title => [title, title]), all[0]);
  byId("grids").replaceChildren(...tables.flatMap((table, t) => {
    const used = new Set(table.read.map(({ title }) => title));
    const left = Object.keys(table.columns).filter(title => !used.has(title));
    const grid = element("table"), body = element("tbody"), head = element("tr");
    for (const name of ["Read as", "Column of the file", "Unit", "First values"]) head.append(element("th", name, { scope: "col" }));
    const titled = element("thead");
    titled.append(head);
    table.read.forEach((one, k) => body.append(gridRow(table, one, `${t}-${k}`)));
    grid.append(titled, body);
    const scroll = element("div", undefined, { className: "scroll", tabIndex: 0 });
    scroll.setAttribute("role", "group");
    scroll.setAttribute("aria-label", "Columns of " + table.file);
    scroll.append(grid);
    const means = [table.observes && `measured: ${table.observes}`, table.orientation && `orientation: ${table.orientation}`];
    const what = [`${table.rows} rows`, ...means.filter(Boolean)].join(", ");
    const parts = [element("h3", table.file), element("p", what, { className: "caption" })];
    if (table.read.length) parts.push(scroll);
    if (left.length) parts.push(element("p", `${table.read.length ? "Not read" : "Its columns"}: ${left.join(", ")}`, { className: "caption" }));
    return parts;
  }));
}

function gridRow(table, { name, unit, title }, id) {
  const row = element("tr"), column = element("select", undefined, { id: "column-" + id });
  options(column, Object.keys(table.columns).map(one => [one, one]), title);
  column.setAttribute("aria-label", `Column of ${name}`);
  const own = table.columns[title].unit, cell = element("td");
  let units = null;
  if (unit && !own) {
    const like = [["deg", "rad"], ["mm", "m", "cm", "inch"]].find(group => group.includes(unit)) || [unit];
    units = element("select", undefined, { id: "unit-" + id });
    options(units, like.map(one => [one, one]), unit);
    units.setAttribute("aria-label", `Unit of ${name}`);
    cell.append(units);
  } else {
    cell.textContent = unit || own || "";
  }
  const say = () => {
    // The unit of another column is that column's own, or is found anew.
    const same = column.value === title, given = same && units ? `${name} [${units.value}]` : name;
    for (const ours of Object.keys(columns)) if (ours.split(" [")[0] === name) delete columns[ours];
    columns[given] = column.value;
    look();
  };
  column.addEventListener("change", say);
  if (units) units.addEventListener("change", say);
  const place = element("td");
  place.append(column);
  row.append(element("th", name, { scope: "row" }), place, cell, element("td", table.columns[title].values.map(short).join(", ")));
  return row;
}

function drawResults() {
  const found = state.results;
  part("results", found, () => {
    byId("verdict").hidden = byId("files-made").hidden = !found;
    byId("tiles").replaceChildren();
    if (!found) return;
    byId("verdict").className = found.trusted ? "" : "doubted";
    byId("headline").textContent = found.headline;
    list("reasons", found.reasons);
    byId("tiles").append(...found.tiles.map(({ label, value }) => {
      const tile = element("div");
      tile.append(element("dt", label), element("dd", value));
      return tile;
    }));
    if (before === "calibrate") byId("verdict").focus();
  });
}

for (const id of ["choose", "folder"]) byId(id).addEventListener("change", async event => {
  await take([...event.target.files].map(file => [file.webkitRelativePath || file.name, file]));
  event.target.value = "";
});
for (const kind of ["dragover", "dragleave", "drop"]) {
  document.addEventListener(kind, event => {
    event.preventDefault();
    byId("drop").classList.toggle("over", kind === "dragover");
    if (kind === "drop" && !byId("choose").disabled && event.dataTransfer.items.length) dropped(event.dataTransfer).then(take);
  });
}
byId("robot").addEventListener("change", () => { if (state.files.length) look(); });
for (const id of ["stack", "points", "camera"]) byId(id).addEventListener("change", () => { columns = {}; look(); });
for (const select of document.querySelectorAll("[data-answer]")) select.addEventListener("change", () => look());
byId("name").addEventListener("click", () => {
  const ours = byId("ours").value.trim();
  if (ours && byId("theirs").value) { columns[ours] = byId("theirs").value; byId("ours").value = ""; look(); }
});
byId("forget").addEventListener("click", () => look({ answers: {} }));
byId("job").addEventListener("input", () => { dirty = true; byId("calibrate").disabled = true; });
byId("check").addEventListener("click", () => told("POST", "check", JSON.stringify({ job: byId("job").value })));
byId("calibrate").addEventListener("click", () => told("POST", "calibrate"));
byId("cancel").addEventListener("click", () => told("POST", "cancel"));

// What another window has done since.
addEventListener("focus", refresh);
document.addEventListener("visibilitychange", () => { if (!document.hidden) refresh(); });

let examples = [];
fetch("examples").then(response => response.json()).then(found => { examples = found.examples; if (state) draw(); });
// After a server that was ended, files are there that nobody has looked at.
refresh().then(() => {
  if (state && state.files.length && !state.look && !state.busy && !state.sentence) look({ robot: state.robot });
});
