"use strict";
const page = JSON.parse(document.getElementById("page").textContent);
const byId = name => document.getElementById(name);
const legend = byId("legend"), pane = byId("pane"), THREE = MeshCat.THREE;
const viewer = new MeshCat.Viewer(pane);
for (const command of page.commands)
  viewer.handle_command_bytearray(Uint8Array.from(atob(command), c => c.charCodeAt(0)));
const nodeAt = path => viewer.scene_tree.find(path.split("/"));

// The nominal arm: the shapes of the calibrated one, seen through.
const glass = new THREE.MeshPhongMaterial({
  color: page.nominal, opacity: 0.3, transparent: true, depthWrite: false,
  polygonOffset: true, polygonOffsetFactor: 2, polygonOffsetUnits: 8,  // where both arms coincide, the calibrated one shows
});
for (const [link, node] of Object.entries(nodeAt("robot").children))
  for (const [i, part] of Object.entries(node.children))
    if (part.children["<object>"])
      viewer.set_object(["nominal", link, i], new THREE.Mesh(part.children["<object>"].object.geometry, glass));

// Arms: a link sits in its parent at origin, then motion; parents come first.
const order = [], placed = new Set([page.root]);
for (let last = -1; order.length > last;) {
  last = order.length;
  page.joints.forEach((joint, k) => {
    if (placed.has(joint.parent) && !placed.has(joint.child)) { placed.add(joint.child); order.push(k); }
  });
}
const matrices = columns => new THREE.Matrix4().fromArray(columns);
const axes = page.joints.map(joint => new THREE.Vector3(...joint.axis));
const arms = Object.entries(page.arms).map(([name, arm]) => ({
  name, root: matrices(arm.root), origins: arm.origins.map(matrices), positions: arm.positions,
}));

function place(arm, positions) {
  const links = { [page.root]: arm.root }, motion = new THREE.Matrix4();
  for (const k of order) {
    const { parent, child, kind } = page.joints[k], q = positions[k];
    if (kind === "turn") motion.makeRotationAxis(axes[k], q);
    else if (kind === "slide") motion.makeTranslation(q * axes[k].x, q * axes[k].y, q * axes[k].z);
    else motion.identity();
    links[child] = links[parent].clone().multiply(arm.origins[k]).multiply(motion);
  }
  for (const [link, T] of Object.entries(links)) viewer.set_transform([arm.name, link], T.toArray());
  if (arm.name === "robot") viewer.set_transform(["frames", "tip"], links[page.tip].toArray());
}

// The measured poses, one after the other.
const play = byId("play"), pose = byId("pose"), row = byId("row"), last = page.rows.length - 1;
const current = new THREE.Mesh(new THREE.SphereGeometry(page.current, 24, 16),
  new THREE.MeshBasicMaterial({ color: 0x009e73, opacity: 0.45, transparent: true, depthWrite: false }));
const MOVE = 700, REST = 500;  // ms from pose to pose, and at each
let at = 0, playing = 0;

function show(moment) {
  at = moment;
  const n = Math.min(Math.floor(moment), last), m = Math.min(n + 1, last), t = moment - n;
  const s = t * t * (3 - 2 * t);
  for (const arm of arms) place(arm, arm.positions[n].map((q, k) => q + s * (arm.positions[m][k] - q)));
  const near = t < 0.5 ? n : m, [x, y, z] = page.points[near], [before, after] = page.errors[near];
  viewer.set_property(["current"], "position", [x, y, z]);
  pose.value = near;
  row.textContent = "Pose " + (near + 1) + " of " + (last + 1) + ", " + page.rows[near] + ": before " +
    before.toFixed(3) + " mm, after " + after.toFixed(3) + " mm";
  viewer.set_dirty();
}

function step(now, since) {
  if (!playing) return;
  const whole = Math.floor(at), elapsed = now - since;
  if (elapsed >= MOVE + REST || whole >= last) {
    show(whole >= last ? 0 : whole + 1);
    requestAnimationFrame(later => step(later, now));
  } else {
    show(whole + Math.min(Math.max(elapsed - REST, 0) / MOVE, 0.999));
    requestAnimationFrame(later => step(later, since));
  }
}

if (last >= 0) {
  viewer.set_object(["current"], current);
  pose.max = last;
  pose.addEventListener("input", () => { stop(); show(Number(pose.value)); });
  play.addEventListener("click", () => {
    if (playing) { stop(); return; }
    playing = 1;
    play.textContent = "\u275a\u275a";
    play.setAttribute("aria-label", "Pause");
    requestAnimationFrame(now => step(now, now - REST));
  });
  show(0);
}

function stop() {
  playing = 0;
  at = Math.round(at);
  play.textContent = "\u25b6";
  play.setAttribute("aria-label", "Play");
}

// Layers that the reader may hide.
const magnify = byId("magnify"), boxes = [...document.querySelectorAll("[data-layer]")];
const wanted = name => boxes.find(box => box.dataset.layer === name).checked;
let names = true;

function choose() {
  for (const box of boxes)
    if (box.dataset.layer === "labels") names = box.checked;
    else viewer.set_property(box.dataset.layer.split("/"), "visible", box.checked);
  if (last >= 0) viewer.set_property(["current"], "visible", wanted("measured"));
  if (magnify) {
    viewer.set_property(["after"], "visible", wanted("after") && !magnify.checked);
    viewer.set_property(["after_magnified"], "visible", wanted("after") && magnify.checked);
    byId("drawn-after").textContent = "\u00d7" + magnify.dataset.scales.split(" ")[+magnify.checked];
  }
  viewer.set_dirty();
}
for (const box of [...boxes, ...(magnify ? [magnify] : [])]) box.addEventListener("change", choose);
byId("layers").open = window.innerWidth > 640;
byId("layers").addEventListener("toggle", () => fit());
choose();

// three.js has y up, the scene z.
const outline = page.outline.map(([x, y, z]) => new THREE.Vector3(x, z, -y));
const camera = viewer.camera, back = new THREE.Vector3(0.72, 0.42, 0.9).normalize();
let touched = false;
viewer.controls.addEventListener("start", () => { touched = true; });

// Centre the outline in the part of the pane that the legend leaves free, and step back until all of it is inside.
function fit() {
  const w = pane.offsetWidth, h = window.innerHeight, cover = legend.getBoundingClientRect();
  const wide = cover.width < 0.5 * w;
  const free = wide ? [cover.right, 0, w, h] : [0, 24, w, cover.top];
  const [fw, fh] = [free[2] - free[0], free[3] - free[1]];
  camera.fov = 35;
  const t = Math.tan(camera.fov * Math.PI / 360), tx = t * fw / h, ty = t * fh / h;
  const right = new THREE.Vector3(0, 1, 0).cross(back).normalize(), up = back.clone().cross(right);
  const target = new THREE.Vector3();
  for (const axis of [right, up, back]) {
    const along = outline.map(p => p.dot(axis));
    target.addScaledVector(axis, (Math.min(...along) + Math.max(...along)) / 2);
  }
  let distance = 0;
  for (const p of outline) {
    const v = p.clone().sub(target);
    const side = Math.max(Math.abs(v.dot(right)) / tx, Math.abs(v.dot(up)) / ty);
    distance = Math.max(distance, v.dot(back) + side);
  }
  distance *= 1.08;
  camera.near = distance / 500;
  camera.far = distance * 50;
  camera.setViewOffset(w, h, (w - free[0] - free[2]) / 2, (h - free[1] - free[3]) / 2, w, h);
  if (!touched) {
    viewer.controls.target.copy(target);
    camera.position.copy(target).addScaledVector(back, distance);
  }
  viewer.set_dirty();
}

// Names of the frames beside their origins, the first place where they cover no other; a hidden frame hides its name.
const labels = page.labels.map(([path, text]) => {
  const element = document.body.appendChild(document.createElement("div"));
  element.className = "label";
  element.textContent = text;
  return { element, object: nodeAt(path).object, w: element.offsetWidth, h: element.offsetHeight };
});

function arrange() {
  const taken = [];
  for (const { element, object, w, h } of labels) {
    const p = new THREE.Vector3().setFromMatrixPosition(object.matrixWorld).project(camera);
    let shown = names && p.z < 1;
    for (let o = object; o; o = o.parent) shown = shown && o.visible;
    element.style.display = shown ? "" : "none";
    if (!shown) continue;
    const x = (p.x + 1) / 2 * pane.offsetWidth, y = (1 - p.y) / 2 * window.innerHeight;
    const places = [];
    for (let k = 0; k < 8; k++)
      places.push([x + 7, y + 4 + k * h], [x + 7, y - 4 - (k + 1) * h], [x - 7 - w, y + 4 + k * h], [x - 7 - w, y - 4 - (k + 1) * h]);
    const free = ([a, b]) => taken.every(r => a + w < r[0] || r[0] + r[2] < a || b + h < r[1] || r[1] + r[3] < b);
    // What would leave the window is moved into it, as long as its frame is there.
    if (x >= 0 && x <= pane.offsetWidth)
      for (const place of places) place[0] = Math.min(Math.max(place[0], 2), pane.offsetWidth - w - 2);
    const [a, b] = places.find(free) || places[0];
    taken.push([a, b, w, h]);
    element.style.transform = "translate(" + a + "px, " + b + "px)";
  }
}
const render = viewer.render.bind(viewer);
viewer.render = () => { render(); arrange(); };

// Served by "calib view", the arm also takes any joint readings: the server closes loops and says what it finds.
if (location.protocol.startsWith("http")) {
  const socket = new WebSocket("ws://" + location.host + "/live"), live = byId("live");
  let sliders = [], busy = false, waiting = false;
  const ask = () => {
    if (busy) { waiting = true; return; }
    busy = true;
    socket.send(JSON.stringify({ readings: sliders.map(slider => Number(slider.value)), apart: page.apart }));
  };
  socket.addEventListener("message", event => {
    const told = JSON.parse(event.data);
    if (told.reload) { location.reload(); return; }
    if (told.readings) {
      live.style.display = "block";
      sliders = told.readings.map(({ name, unit, lower, upper, value }) => {
        const label = live.appendChild(document.createElement("label")), span = document.createElement("span");
        const slider = document.createElement("input"), output = document.createElement("output");
        span.textContent = span.title = name;
        Object.assign(slider, { type: "range", min: lower, max: upper, step: (upper - lower) / 1000, value });
        const tell = () => { output.textContent = Number(slider.value).toFixed(unit === "deg" ? 1 : 3) + " " + unit; };
        slider.addEventListener("input", () => { if (playing) stop(); tell(); ask(); });
        tell();
        label.append(span, slider, output);
        return slider;
      });
      const said = live.appendChild(document.createElement("p"));
      said.id = "said";
      fit();
      return;
    }
    busy = false;
    byId("said").textContent = told.sentence;
    if (told.positions) {
      for (const arm of arms) place(arm, told.positions[arm.name]);
      viewer.set_dirty();
    }
    if (waiting) { waiting = false; ask(); }
  });
}

window.addEventListener("load", fit);
window.addEventListener("resize", fit);
