"use strict";
const page = JSON.parse(document.getElementById("page").textContent);
const byId = name => document.getElementById(name);
const legend = byId("legend"), pane = byId("pane"), THREE = MeshCat.THREE;
// Nothing is drawn before everything is there.
const viewer = new MeshCat.Viewer(pane, false);
for (const command of page.commands) {
  const text = atob(command), bytes = new Uint8Array(text.length);  // a call for each would take ten times as long
  for (let k = 0; k < bytes.length; k++) bytes[k] = text.charCodeAt(k);
  viewer.handle_command_bytearray(bytes);
}
const boxes = [...document.querySelectorAll("[data-layer]")];
const wanted = name => boxes.find(box => box.dataset.layer === name).checked;
// meshcat's own panel: boxes and numbers without names, for things that the legend has switches for.
viewer.gui.domElement.remove();
const canvas = pane.querySelector("canvas");
canvas.setAttribute("role", "img");
canvas.setAttribute("aria-label", document.title + ": the arm, measured points and errors in space");
const nodeAt = path => viewer.scene_tree.find(path.split("/"));

// The nominal arm: the shapes of the calibrated one, seen through. It joins the second picture: the first comes sooner.
const glass = new THREE.MeshLambertMaterial({
  color: page.nominal, opacity: 0.3, transparent: true, depthWrite: false,
  polygonOffset: true, polygonOffsetFactor: 2, polygonOffsetUnits: 8,  // where both arms coincide, the calibrated one shows
});
function addNominal() {
  for (const [link, node] of Object.entries(page.arms.nominal ? nodeAt("robot").children : {}))
    for (const [i, part] of Object.entries(node.children))
      if (part.children["<object>"])
        viewer.set_object(["nominal", link, i], new THREE.Mesh(part.children["<object>"].object.geometry, glass));
  viewer.set_dirty();
}

// Points, and error vectors from them: many copies of one shape, each with its place and colour.
const { measured, before, after } = page.clouds;
const paint = new THREE.MeshBasicMaterial({ vertexColors: true });
const thread = new THREE.LineBasicMaterial({ vertexColors: true }), up = new THREE.Vector3(0, 1, 0);
const night = matchMedia("(prefers-color-scheme: dark)");

// In one geometry: where there is no graphics card, instances are drawn one by one.
function copies(shape, matrices, tint) {
  const corners = shape.attributes.position, v = corners.count, index = shape.index ? shape.index.array : null;
  const each = index ? index.length : v, n = matrices.length, p = new THREE.Vector3();
  const position = new Float32Array(3 * n * v), color = new Float32Array(3 * n * v), faces = new Uint32Array(n * each);
  matrices.forEach((matrix, k) => {
    const { r, g, b } = tint(k);
    for (let i = 0; i < v; i++) {
      p.fromBufferAttribute(corners, i).applyMatrix4(matrix).toArray(position, 3 * (k * v + i));
      color.set([r, g, b], 3 * (k * v + i));
    }
    for (let i = 0; i < each; i++) faces[k * each + i] = k * v + (index ? index[i] : i);
  });
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.BufferAttribute(position, 3));
  geometry.setAttribute("color", new THREE.BufferAttribute(color, 3));
  geometry.setIndex(new THREE.BufferAttribute(faces, 1));
  geometry.userData.each = each;
  return new THREE.Mesh(geometry, paint);
}

// Of thousands of points each is one of the graphics card's own, and an error is a line. ``outline``: none is a square.
function specks(points, tint, size, outline) {
  const geometry = new THREE.BufferGeometry().setFromPoints(points), across = size / Math.tan(VIEW * Math.PI / 360);
  geometry.setAttribute("color", new THREE.Float32BufferAttribute(points.flatMap((_, n) => tint(n).toArray()), 3));
  geometry.userData.each = 1;
  const look = new THREE.PointsMaterial({ size: across, vertexColors: true });
  if (outline) {
    const picture = document.createElement("canvas"), pen = picture.getContext("2d");
    picture.width = picture.height = 32;
    pen.fillStyle = "#fff";
    pen.fill(new Path2D(outline));
    Object.assign(look, { map: new THREE.CanvasTexture(picture), alphaTest: 0.5 });
  }
  return new THREE.Points(geometry, look);
}
const VIEW = 35;  // degrees of the camera
const ROUND = "M16 0a16 16 0 1 0 .01 0z", EDGED = "M16 0L32 16 16 32 0 16z";
const many = measured.length > 500;
// Rows in an order in which the first of them are from everywhere: where little can be drawn, these are.
const common = (a, b) => b ? common(b, a % b) : a;
let stride = Math.max(1, Math.round(0.618 * measured.length));
while (common(stride, measured.length) > 1) stride++;
const spread = measured.map((_, k) => k * stride % measured.length);

function vectors(name, cloud, shape, outline, tint) {
  const at = spread.map(n => new THREE.Vector3(...measured[n]));
  const way = spread.map(n => new THREE.Vector3(...cloud.errors[n]).multiplyScalar(factor));
  const ends = at.map((p, n) => p.clone().add(way[n])), group = new THREE.Group();
  if (many) {
    const lines = new THREE.BufferGeometry().setFromPoints(at.flatMap((p, n) => [p, ends[n]]));
    const colours = at.flatMap((_, n) => { const rgb = tint(n).toArray(); return [...rgb, ...rgb]; });
    lines.setAttribute("color", new THREE.Float32BufferAttribute(colours, 3));
    lines.userData.each = 2;
    group.add(new THREE.LineSegments(lines, thread), specks(ends, tint, 1.3 * page.radius, outline));
  } else {
    const one = new THREE.Vector3(1, 1, 1), still = new THREE.Quaternion();
    const sticks = at.map((p, n) => {
      const length = way[n].length(), turn = new THREE.Quaternion();
      if (length > 0) turn.setFromUnitVectors(up, way[n].clone().divideScalar(length));
      return new THREE.Matrix4().compose(p.clone().addScaledVector(way[n], 0.5), turn, new THREE.Vector3(1, length, 1));
    });
    const stick = new THREE.CylinderGeometry(0.28 * page.radius, 0.28 * page.radius, 1, 3, 1, true);
    const places = ends.map(p => new THREE.Matrix4().compose(p, still, one));
    group.add(copies(stick, sticks, tint), copies(shape, places, tint));
  }
  put(name, group);
}

// Where the calibrated tool is with 95 %, around some of the predictions and as much larger as the errors are.
const haze = new THREE.MeshBasicMaterial({ color: 0x009e73, opacity: 0.22, transparent: true, depthWrite: false });
function regions() {
  const places = page.regions.map(([n, axes]) => {
    const [a, b, c] = [0, 3, 6].map(k => new THREE.Vector3(...axes.slice(k, k + 3)).multiplyScalar(factor));
    const centre = measured[n].map((x, k) => x + factor * after.errors[n][k]);
    return new THREE.Matrix4().makeBasis(a, b, c).setPosition(...centre);
  });
  const shape = copies(new THREE.IcosahedronGeometry(1, 2), places, () => new THREE.Color());
  shape.material = haze;
  put("regions", shape);
}

function put(name, object) {
  nodeAt(name).children["<object>"]?.object.traverse(part => part.geometry?.dispose());
  viewer.set_object([name], object);
}

// What colours may mean. Those of kinds are Okabe and Ito's, which every kind of colour vision tells apart.
const KINDS = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#8a8f94"].map(c => new THREE.Color(c));
const facing = error => {
  const size = error.map(Math.abs), k = size.indexOf(Math.max(...size));
  return 2 * k + (error[k] < 0);
};
const meanings = { direction: ["+x", "\u2212x", "+y", "\u2212y", "+z", "\u2212z"] };
const kindOf = { direction: (cloud, n) => facing(cloud.errors[n]) };
for (const [name, { names, kinds }] of Object.entries(page.colourings)) {
  meanings[name] = names.length > 7 ? [...names.slice(0, 6), "others"] : names;
  kindOf[name] = (_, n) => Math.min(kinds[n], 6);
}
const colour = byId("colour"), key = byId("key");

// Drawn anew whenever the reader turns the errors up or the light down, or asks for other colours.
let factor = page.scales[0];
function draw() {
  const clouds = page.clouds, paints = night.matches ? clouds.dark : clouds.light;
  const tints = paints.scale.map(c => new THREE.Color(c)), dots = new THREE.Color(paints.measured);
  nodeAt("Grid").children["<object>"].object.material.color.set(paints.grid);
  const by = colour ? colour.value : "error", kind = kindOf[by];
  document.querySelectorAll("[data-shade]").forEach(e => {
    e.style.background = "#" + (kind || e.dataset.shade === "dot" ? dots : tints.at(e.dataset.shade)).getHexString();
  });
  const tint = cloud => kind ? k => KINDS[kind(cloud, spread[k])] : k => tints[cloud.kinds[spread[k]]];
  if (colour) {
    byId("magnitude").hidden = Boolean(kind);
    key.replaceChildren(...(meanings[by] || []).map((text, k) => {
      const item = document.createElement("span"), swatch = document.createElement("i");
      swatch.style.background = "#" + KINDS[k].getHexString();
      item.append(swatch, text);
      return item;
    }));
  }
  if (!measured.length) return;
  const ofDots = by in page.colourings ? tint(after) : () => dots, r = page.radius;
  const places = spread.map(n => new THREE.Vector3(...measured[n]));
  const dot = new THREE.OctahedronGeometry(1.1 * r), diamond = new THREE.OctahedronGeometry(1.6 * r);
  // Of hundreds none is looked at alone, and a machine without a graphics card draws corners one by one.
  const ball = measured.length > 300 ? new THREE.BoxGeometry(1.5 * r, 1.5 * r, 1.5 * r) : new THREE.IcosahedronGeometry(1.2 * r, 0);
  put("measured", many ? specks(places, ofDots, 1.3 * r, ROUND)
    : copies(dot, places.map(p => new THREE.Matrix4().makeTranslation(p.x, p.y, p.z)), ofDots));
  if (page.judged) {
    vectors("before", before, ball, null, tint(before));
    vectors("after", after, diamond, EDGED, tint(after));
  }
  if (page.regions.length) regions();
  for (const name of ["before", "after"]) if (byId("drawn-" + name)) byId("drawn-" + name).textContent = "\u00d7" + factor;
}
if (colour) colour.addEventListener("change", () => { draw(); choose(); });
draw();
night.addEventListener("change", () => { draw(); choose(); });

// Without a graphics card a picture takes long. There, while something moves, less is drawn: the calibrated arm in coarse
// shapes, some points from everywhere, and as many pixels as there is time for. What rests is drawn whole.
const LATE = 70, STILL = 150, MOST = 3000, SHEER = ["nominal", "regions"];  // ms of two pictures, ms, corners
let late = 0, light = false, moved = 0, calm = 0, share = 0.5;  // of the pixels across
function moving() {
  if (late > 2) lighten(true);
  if (!moved) requestAnimationFrame(rest);
  [moved, calm] = [performance.now(), 0];
}
// It rests where some time, and pictures for which it might have moved, went by: in one long picture it cannot move.
function rest() {
  if (++calm > 3 && performance.now() - moved > STILL) { moved = 0; lighten(false); } else requestAnimationFrame(rest);
}
function timed() {
  if (!moved || (late > 2 && !light)) return;
  const start = performance.now(), lighter = light;
  requestAnimationFrame(() => requestAnimationFrame(() => {
    const slow = performance.now() - start > LATE;
    if (lighter) share = slow ? Math.max(0.25, 0.8 * share) : share;
    else late = slow ? late + 1 : 0;
  }));
}
function lighten(on) {
  if (light === on) return;
  light = on;
  nodeAt("robot").object.traverse(part => {
    if (!part.isMesh) return;
    const shapes = part.userData.shapes ||= { whole: part.geometry, coarse: coarse(part.geometry) };
    part.geometry = on ? shapes.coarse : shapes.whole;
  });
  const parts = [];
  for (const name of ["measured", "before", "after"])
    if (boxes.find(box => box.dataset.layer === name)?.checked)
      nodeAt(name).object.traverse(part => { if (part.geometry) parts.push(part.geometry); });
  const rows = MOST / parts.reduce((sum, geometry) => sum + geometry.userData.each / (geometry.index ? 3 : 1), 0);
  for (const geometry of parts) geometry.setDrawRange(0, on ? Math.ceil(rows) * geometry.userData.each : Infinity);
  choose();
}
// Of all corners in a cell of a grid the first stands for all; they keep normals and colours.
function coarse(whole) {
  const at = whole.attributes.position, index = whole.index, p = new THREE.Vector3();
  whole.computeBoundingBox();
  const { min, max } = whole.boundingBox, cell = Math.max(...max.clone().sub(min).toArray()) / 9 || 1;
  const first = new Map(), faces = new Map();
  const corner = i => {
    const key = p.fromBufferAttribute(at, i).sub(min).divideScalar(cell).toArray().map(Math.floor).join();
    if (!first.has(key)) first.set(key, i);
    return first.get(key);
  };
  for (let k = 0; k + 2 < (index || at).count; k += 3) {
    const face = [0, 1, 2].map(i => corner(index ? index.getX(k + i) : k + i)), [a, b, c] = face;
    if (a !== b && b !== c && c !== a) faces.set([...face].sort().join(), face);
  }
  const made = new THREE.BufferGeometry();
  Object.assign(made.attributes, whole.attributes);
  made.setIndex([...faces.values()].flat());
  return made;
}

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
  moving();
  if (arm.name === "robot") viewer.set_transform(["frames", "tip"], links[page.tip].toArray());
}

// The measured poses, one after the other.
const play = byId("play"), pose = byId("pose"), row = byId("row"), last = page.rows.length - 1;
const current = new THREE.Mesh(new THREE.SphereGeometry(2.7 * page.radius, 24, 16),
  new THREE.MeshBasicMaterial({ color: 0x009e73, opacity: 0.45, transparent: true, depthWrite: false }));
const MOVE = 700, REST = 500;  // ms from pose to pose, and at each
let at = 0, playing = 0;
// Told the joint readings of every pose that is shown; those moved by hand, once the page is served live, follow.
let follow = () => {};
const plain = (x, digits) => x.toFixed(digits).replace(/^-(?=[0.]*$)/, "");
// Rest and move from a row to the next: rows of a stream follow each other as they did.
const ways = n => {
  const between = page.times ? page.times[n + 1] - page.times[n] : NaN;
  return between > 0 && between < 1 ? [0, 1000 * between] : [REST, MOVE];
};
const mixed = (a, b, s) => a.map((q, k) => q + s * (b[k] - q));

function show(moment) {
  at = moment;
  const n = Math.min(Math.floor(moment), last), m = Math.min(n + 1, last), t = moment - n;
  const s = ways(n)[0] ? t * t * (3 - 2 * t) : t;
  for (const arm of arms) place(arm, mixed(arm.positions[n], arm.positions[m], s));
  if (page.readings.length) follow(mixed(page.readings[n], page.readings[m], s));
  const near = t < 0.5 ? n : m, [lengthBefore, lengthAfter] = page.lengths[near];
  viewer.set_property(["current"], "position", measured[near]);
  viewer.set_property(["current"], "visible", wanted("measured"));
  pose.value = near;
  row.textContent = `Pose ${near + 1} of ${last + 1}, ${page.rows[near]}` +
    (page.judged ? `: before ${lengthBefore.toFixed(3)} mm, after ${lengthAfter.toFixed(3)} mm` : "");
  byId("joints").textContent = page.readings.length
    ? page.joint_names.map(([name, unit], k) => `${name}\u00a0${plain(page.readings[near][k], 2)}\u00a0${unit}`).join(", ") : "";
  viewer.set_dirty();
}

function step(now, since) {
  if (!playing) return;
  let whole = Math.floor(at), [rest, move] = ways(whole);
  for (; whole < last && now - since >= rest + move; [rest, move] = ways(++whole)) since += rest + move;
  if (whole >= last) {
    if (at < last || now - since >= REST) { show(at < last ? last : 0); since = now; }
  } else {
    show(whole + Math.min(Math.max(now - since - rest, 0) / move, 0.999));
  }
  requestAnimationFrame(later => step(later, since));
}

if (last >= 0) {
  viewer.set_object(["current"], current);
  byId("joints").style.minHeight = 1.45 * Math.ceil(page.joint_names.length / 2) + "em";  // nothing below it jumps
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
} else {
  for (const arm of arms) place(arm, arm.positions[0]);
}

function stop() {
  playing = 0;
  at = Math.round(at);
  play.textContent = "\u25b6";
  play.setAttribute("aria-label", "Play");
}

// Layers that the reader may hide.
const turns = byId("turns");
let names = true;

function choose() {
  for (const box of boxes)
    if (box.dataset.layer === "labels") names = box.checked;
    else viewer.set_property(box.dataset.layer.split("/"), "visible", box.checked && !(light && SHEER.includes(box.dataset.layer)));
  if (last >= 0) viewer.set_property(["current"], "visible", wanted("measured"));
  viewer.set_dirty();
}
for (const box of boxes) box.addEventListener("change", choose);
if (turns) turns.addEventListener("input", () => {
  factor = page.factors[turns.value];
  turns.setAttribute("aria-valuetext", factor + " times");
  draw();
  choose();
});
byId("layers").open = window.innerWidth > 640;
byId("layers").addEventListener("toggle", () => fit());
choose();

// three.js has y up, the scene z.
const outline = page.outline.map(([x, y, z]) => new THREE.Vector3(x, z, -y));
const camera = viewer.camera, whence = {
  all: () => new THREE.Vector3(0.72, 0.42, 0.9),
  front: () => new THREE.Vector3(1, 0, 0),
  side: () => new THREE.Vector3(0, 0, 1),
  top: () => new THREE.Vector3(0, 1, 1e-4),
  "along the tool": () => axis("frames/tip", 2).multiplyScalar(-1).add(new THREE.Vector3(1e-4, 0, 1e-4)),
  "from the instrument": () => axis("frames/instrument", 3).sub(middle()),
};
const axis = (path, column) => {
  const { object } = nodeAt(path);
  object.updateWorldMatrix(true, false);
  return new THREE.Vector3().setFromMatrixColumn(object.matrixWorld, column);
};
const middle = () => new THREE.Box3().setFromPoints(outline).getCenter(new THREE.Vector3());
let back = whence.all().normalize(), touched = false;
for (const button of document.querySelectorAll("[data-view]")) button.addEventListener("click", () => {
  back = whence[button.dataset.view]().normalize();
  touched = false;
  fit();
});
viewer.controls.addEventListener("start", () => { touched = true; });

// Centre the outline in the part of the pane that the legend leaves free, and step back until all of it is inside.
function fit() {
  const w = pane.offsetWidth, h = window.innerHeight, cover = legend.getBoundingClientRect();
  const wide = cover.width < 0.5 * w;
  const free = wide ? [cover.right, 0, w, h] : [0, 24, w, cover.top];
  const [fw, fh] = [free[2] - free[0], free[3] - free[1]];
  camera.fov = VIEW;
  const t = Math.tan(camera.fov * Math.PI / 360), tx = t * fw / h, ty = t * fh / h;
  const right = up.clone().cross(back).normalize(), above = back.clone().cross(right);
  const target = new THREE.Vector3();
  for (const axis of [right, above, back]) {
    const along = outline.map(p => p.dot(axis));
    target.addScaledVector(axis, (Math.min(...along) + Math.max(...along)) / 2);
  }
  let distance = 0;
  for (const p of outline) {
    const v = p.clone().sub(target);
    const side = Math.max(Math.abs(v.dot(right)) / tx, Math.abs(v.dot(above)) / ty);
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
  const element = byId("stage").appendChild(document.createElement("div"));
  element.className = "label";
  element.textContent = text;
  return { element, object: nodeAt(path).object, w: element.offsetWidth, h: element.offsetHeight };
});

function arrange() {
  const taken = [], across = pane.offsetWidth, high = window.innerHeight;  // asked once: an answer takes a layout
  for (const { element, object, w, h } of labels) {
    const p = new THREE.Vector3().setFromMatrixPosition(object.matrixWorld).project(camera);
    let shown = names && p.z < 1 && Math.abs(p.x) < 1 && Math.abs(p.y) < 1;
    for (let o = object; o; o = o.parent) shown = shown && o.visible;
    element.style.display = shown ? "" : "none";
    if (!shown) continue;
    const x = (p.x + 1) / 2 * across, y = (1 - p.y) / 2 * high;
    const places = [];
    for (let k = 0; k < 8; k++)
      places.push([x + 7, y + 4 + k * h], [x + 7, y - 4 - (k + 1) * h], [x - 7 - w, y + 4 + k * h], [x - 7 - w, y - 4 - (k + 1) * h]);
    const free = ([a, b]) => taken.every(r => a + w < r[0] || r[0] + r[2] < a || b + h < r[1] || r[1] + r[3] < b);
    for (const place of places) place[0] = Math.min(Math.max(place[0], 2), across - w - 2);
    const [a, b] = places.find(free) || places[0];
    taken.push([a, b, w, h]);
    element.style.transform = "translate(" + a + "px, " + b + "px)";
  }
}
// As long as a round length is at the middle of what is looked at.
function measure() {
  const far = camera.position.distanceTo(viewer.controls.target);
  const pixels = window.innerHeight / (2 * far * Math.tan(camera.fov * Math.PI / 360));
  const power = 10 ** Math.floor(Math.log10(120 / pixels));
  const length = [5, 2, 1].map(k => k * power).find(l => l * pixels <= 120) || power;
  byId("bar").style.width = length * pixels + "px";
  const text = length >= 0.1 ? `${+length.toPrecision(1)} m` : `${+(1000 * length).toPrecision(1)} mm`;
  if (byId("bar").textContent !== text) byId("bar").textContent = text;
}
const render = viewer.render.bind(viewer);
viewer.render = () => {
  const ratio = window.devicePixelRatio * (light ? share : 1);
  if (viewer.renderer.getPixelRatio() !== ratio) viewer.renderer.setPixelRatio(ratio);  // empties it: drawn at once
  render(); arrange(); measure(); timed();
};
viewer.controls.addEventListener("change", moving);

// A point is told when it is pointed at, and shown with the arm when it is clicked.
const told = byId("told");
let pressed = [0, 0];
function pointed(event) {
  let best = -1, least = 14;
  const p = new THREE.Vector3(), T = camera.projectionMatrix.clone();
  T.multiply(camera.matrixWorldInverse).multiply(viewer.scene.matrixWorld);
  measured.forEach(([px, py, pz], n) => {
    p.set(px, py, pz).applyMatrix4(T);
    const x = (p.x + 1) / 2 * pane.offsetWidth, y = (1 - p.y) / 2 * window.innerHeight;
    const d = Math.hypot(x - event.clientX, y - event.clientY);
    if (p.z < 1 && d < least) [best, least] = [n, d];
  });
  return wanted("measured") || best < 0 ? best : -1;
}
if (last >= 0) {
  pane.addEventListener("pointermove", event => {
    const n = event.buttons ? -1 : pointed(event);
    told.style.display = n < 0 ? "none" : "block";
    if (n < 0) return;
    const [b, a] = page.lengths[n];
    told.textContent = page.rows[n] + (page.judged ? `: ${b.toFixed(3)} mm before, ${a.toFixed(3)} mm after` : "");
    const left = Math.max(2, Math.min(event.clientX + 12, pane.offsetWidth - told.offsetWidth - 4));
    told.style.transform = `translate(${left}px, ${event.clientY + 14}px)`;
  });
  pane.addEventListener("pointerdown", event => { pressed = [event.clientX, event.clientY]; });
  pane.addEventListener("pointerup", event => {
    if (Math.hypot(event.clientX - pressed[0], event.clientY - pressed[1]) > 4) return;
    const n = pointed(event);
    if (n >= 0) { stop(); show(n); }
  });
}

// Served by "calib view", the arm also takes any joint readings: the server closes loops and says what it finds.
// In a sandbox, which has no origin, nobody answers.
if (location.protocol.startsWith("http") && self.origin !== "null") {
  const socket = new WebSocket("ws://" + location.host + "/live"), live = byId("live");
  let readings = [], busy = false, waiting = false;
  const ask = () => {
    if (busy) { waiting = true; return; }
    busy = true;
    socket.send(JSON.stringify({ readings, apart: page.apart }));
  };
  socket.addEventListener("message", event => {
    const told = JSON.parse(event.data);
    if (told.reload) { location.reload(); return; }
    if (told.readings) {
      live.style.display = "block";
      if (last >= 0) byId("joints").style.display = "none";  // the sliders tell them
      readings = told.readings.map(({ value }) => value);
      const sliders = told.readings.map(({ name, unit, lower, upper, value }, k) => {
        const label = live.appendChild(document.createElement("label")), span = document.createElement("span");
        const slider = document.createElement("input"), output = document.createElement("output");
        span.textContent = span.title = name;
        // A measured pose may lie beyond the limits that the URDF states.
        const all = page.readings.map(pose => pose[k]);
        const [min, max] = all.reduce(([a, b], q) => [Math.min(a, q), Math.max(b, q)], [lower, upper]);
        Object.assign(slider, { type: "range", min, max, step: "any", value });
        slider.setAttribute("aria-label", name + " in " + unit);
        const tell = q => { output.textContent = plain(q, unit === "deg" ? 1 : 2) + " " + unit; };
        slider.addEventListener("input", () => {
          if (playing) stop();
          readings[k] = Number(slider.value);
          tell(readings[k]);
          ask();
        });
        tell(value);
        label.append(span, slider, output);
        return q => { slider.value = q; tell(q); };
      });
      // From any pose that is shown a person goes on with one joint, and the others stay.
      follow = shown => { readings = shown; sliders.forEach((set, k) => set(shown[k])); };
      const said = live.appendChild(document.createElement("p"));
      said.id = "said";
      said.setAttribute("aria-live", "polite");
      if (last >= 0) show(at);
      fit();
      return;
    }
    busy = false;
    byId("said").textContent = told.sentence;
    if (told.positions) {
      for (const arm of arms) place(arm, told.positions[arm.name]);
      if (last >= 0) {
        viewer.set_property(["current"], "visible", false);
        row.textContent = "Joints moved by hand.";
      }
      viewer.set_dirty();
    }
    if (waiting) { waiting = false; ask(); }
  });
}

window.addEventListener("load", () => {
  viewer.set_3d_pane_size();
  fit();
  viewer.animate();
  requestAnimationFrame(() => requestAnimationFrame(addNominal));
});
window.addEventListener("resize", fit);
