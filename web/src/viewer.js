// The viewer of recorded episodes: a list, a 3-D view of one or two episodes on one clock, and a strip chart.

import { PCFShadowMap, PerspectiveCamera, Vector3, WebGLRenderer } from "three";
import { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";
import { Chart, constant, figure, readable, title } from "./chart.js";
import { locate, motionOf, solidsOf } from "./unpack.js";
import { World } from "./world.js";

const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 4];
/** Directions of the cameras from the centre of the motion. */
const VIEWS = { Front: [0.8, -0.56, 0.36], Side: [0.06, -1, 0.22], Top: [0.001, -0.02, 1], Object: [0.7, -0.6, 0.42] };

function element(name, attributes = {}, ...children) {
  const node = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    if (key.startsWith("on")) node.addEventListener(key.slice(2), value);
    else if (value !== false && value !== undefined) node.setAttribute(key, value === true ? "" : value);
  }
  node.append(...children.filter((child) => child !== undefined && child !== null));
  return node;
}

/** Colours of the page's theme. */
function style() {
  const of = getComputedStyle(document.documentElement);
  const value = (name, otherwise) => of.getPropertyValue(name).trim() || otherwise;
  return { background: value("--stage", "#eceae6"), accent: value("--accent", "#1f5f95") };
}

/** Zero without a sign: the width of a closed gripper may be a rounded negative number. */
const positive = (text) => text.replace(/-(0(?:\.0+)?)(?![\d.])/g, "$1");

/** A viewer in `parent` for the clips of a reel. */
export class Viewer {
  constructor(parent, reel) {
    this.reel = reel;
    this.cache = new Map();
    this.now = 0;
    this.speed = 1;
    this.playing = false;
    this.worlds = [];
    this.sides = [];
    this.build(parent);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
      this.worlds.forEach((world) => world.restyle(style()));
      this.draw();
    });
  }

  /** Replaces the reel. The open episode stays until another one is opened. */
  load(reel) {
    this.reel = reel;
    this.cache.clear();
    this.solids = undefined;
  }

  build(parent) {
    const button = (label, text, act) => element("button", { type: "button", "aria-label": label, title: label, onclick: act }, text);
    this.canvas = element("canvas", { tabindex: 0, "aria-label": "3-D view. Drag to orbit, scroll to zoom." });
    this.films = element("div", { class: "view-films" });
    this.labels = element("div", { class: "view-labels", "aria-live": "off" });
    this.stage = element("div", { class: "view-stage" }, this.canvas, this.films, this.labels);
    this.play = button("Play", "▶", () => this.toggle());
    this.play.className = "view-play";
    this.slider = element("input", {
      type: "range", min: 0, max: 1, step: 0.001, value: 0, "aria-label": "Time", oninput: () => this.seek(Number(this.slider.value)),
    });
    this.clock = element("output", { class: "view-clock" });
    this.speeds = element(
      "select", { "aria-label": "Speed", onchange: () => { this.speed = Number(this.speeds.value); } },
      ...SPEEDS.map((s) => element("option", { value: s, selected: s === 1 }, `${s}×`)),
    );
    this.views = element(
      "select", { "aria-label": "Camera", onchange: () => this.look(this.views.value) },
      ...Object.keys(VIEWS).map((name) => element("option", { value: name }, name)),
    );
    const check = (label, on, act) => {
      const box = element("input", { type: "checkbox", checked: on, onchange: () => act(box.checked) });
      return element("label", {}, box, ` ${label}`);
    };
    this.pairBox = check("Both", true, (on) => { this.paired = on; this.arrange(); });
    this.paired = true;
    this.contactBox = check("Contacts", true, (on) => {
      this.contacts = on;
      this.worlds.forEach((world) => { world.showContacts = on; });
      this.pose();
    });
    this.contacts = true;
    this.bar = element(
      "div", { class: "view-bar" },
      button("Back one frame", "‹", () => this.nudge(-1)), this.play, button("Forward one frame", "›", () => this.nudge(1)),
      this.slider, this.clock, this.speeds, this.views, this.pairBox, this.contactBox,
    );
    this.legend = element(
      "p", { class: "view-legend" },
      element("span", { class: "c0" }, "robot and object"), element("span", { class: "c1" }, "robot and surroundings"),
      element("span", { class: "c2" }, "object and surroundings"), "Arrows: normal forces (log scale).",
    );
    this.strip = element("div", { class: "view-strip" });
    this.facts = element("div", { class: "view-facts" });
    this.root = element("div", { class: "view", role: "group", "aria-label": "Episode viewer" }, this.stage, this.bar, this.legend, this.strip, this.facts);
    this.root.addEventListener("keydown", (event) => this.key(event));
    parent.append(this.root);
    try {
      this.renderer = new WebGLRenderer({ canvas: this.canvas, antialias: true });
      this.renderer.shadowMap.enabled = true;
      this.renderer.shadowMap.type = PCFShadowMap;
      this.renderer.setScissorTest(true);
    } catch {
      this.stage.replaceChildren(element("p", { class: "view-none" }, "This browser offers no WebGL, so the 3-D view is not shown."));
      this.legend.hidden = true;
    }
    this.camera = new PerspectiveCamera(36, 1, 0.02, 20);
    this.camera.up.set(0, 0, 1);
    this.controls = new OrbitControls(this.camera, this.canvas);
    this.controls.enableDamping = false;
    this.controls.addEventListener("change", () => this.draw());
    this.look("Front");
    new ResizeObserver(() => this.resize()).observe(this.stage);
  }

  look(name) {
    const { centre, radius } = this.bounds ?? { centre: new Vector3(0.4, 0, 0.3), radius: 0.7 };
    const direction = new Vector3(...VIEWS[name]).normalize();
    const world = this.worlds[0];
    if (name === "Object" && world) {
      this.controls.target.set(...world.object(this.now));
      this.camera.position.copy(this.controls.target).addScaledVector(direction, 0.9 * radius);
    } else {
      // The surroundings below the motion are worth seeing too.
      this.controls.target.copy(centre).addScaledVector(new Vector3(0, 0, -1), name === "Top" ? 0 : 0.2 * radius);
      this.camera.position.copy(this.controls.target).addScaledVector(direction, 3.1 * radius);
    }
    this.controls.update();
    this.draw();
  }

  async side(at) {
    if (!this.cache.has(at)) {
      this.solids ??= await solidsOf(this.reel);
      this.cache.set(at, { clip: this.reel.clips[at], motion: await motionOf(this.reel.clips[at]) });
    }
    return this.cache.get(at);
  }

  /** Opens an episode, with another one beside it if `second` is a number. */
  async open(first, second) {
    const ticket = (this.ticket = (this.ticket ?? 0) + 1);
    const wanted = second === null || second === undefined ? [first] : [first, second];
    const sides = await Promise.all(wanted.map((at) => this.side(at)));
    if (ticket !== this.ticket) return;
    this.pause();
    this.all = sides;
    this.pairBox.hidden = sides.length < 2;
    this.now = 0;
    this.arrange();
    this.root.dataset.ready = String(first);
  }

  /** Sets up the open episodes: both, or the first alone. */
  arrange() {
    this.sides = this.paired ? this.all : this.all.slice(0, 1);
    this.worlds.forEach((world) => world.dispose());
    const theme = style();
    const shown = this.sides.some(({ clip }) => clip.frames > 0) && this.renderer;
    const filmed = !shown && this.sides.some(({ clip }) => clip.film?.length);
    const touched = this.sides.some(({ motion }) => motion.contacts.some((points) => points.length > 0));
    this.stage.hidden = !shown && !filmed;
    this.canvas.hidden = this.views.hidden = !shown;
    this.films.hidden = !filmed;
    this.films.replaceChildren(...(filmed ? this.sides.map(({ clip }) => element("img", { alt: `Camera images of ${clip.title}` })) : []));
    this.legend.hidden = this.contactBox.hidden = !shown || !touched;
    this.worlds = shown ? this.sides.map(({ clip, motion }) => new World(clip, motion, this.solids, theme)) : [];
    this.worlds.forEach((world) => { world.showContacts = this.contacts; });
    if (this.worlds[0]) {
      const known = this.bounds;
      this.bounds = this.worlds[0].bounds();
      // A camera that the reader has moved stays, unless the scene is another one.
      if (!known || known.centre.distanceTo(this.bounds.centre) > 0.5 * known.radius) this.look(this.views.value);
    }
    this.end = Math.max(0.001, ...this.sides.map(({ motion }) => motion.end));
    this.slider.max = this.end;
    this.labels.replaceChildren(...this.sides.map(({ clip }, i) => {
      const state = element("span", { class: "view-phase" });
      return element(
        "div", { class: `view-label side${i}` },
        element("div", {}, element("b", {}, clip.title), element("span", { class: clip.success ? "chip good" : "chip bad" }, clip.outcome), state),
      );
    }));
    this.chart?.dispose();
    this.chart = new Chart(this.strip, this.sides, this.end, (t) => this.seek(t));
    this.describe();
    this.resize();
    this.seek(Math.min(this.now, this.end));
  }

  /** Events, parameters and the command of each open episode. */
  describe() {
    // Measures that do not change during an episode have no line in the chart.
    const sides = this.sides.map(({ clip, motion }) => {
      const marks = motion.signals.map((signal) => readable(signal)).map((signal) => [title(signal.name), constant(signal), signal.unit]);
      const known = marks.filter(([, value]) => value !== undefined).map(([name, value, unit]) => [name, `${figure(value)} ${unit}`.trim()]);
      return new Map([...clip.parameters, ...known]);
    });
    const names = [...new Set(sides.flatMap((side) => [...side.keys()]))];
    const rows = names.map((name) => {
      const values = sides.map((side) => side.get(name) ?? "–");
      const differs = values.length > 1 && values[0] !== values[1];
      return element("tr", { class: differs ? "differs" : false }, element("th", { scope: "row" }, name), ...values.map((v) => element("td", {}, v)));
    });
    const events = this.sides.map(({ clip }) => element(
      "div", {},
      element("h3", {}, clip.title),
      element("ol", { class: "view-events" }, ...clip.events.map((event) => element(
        "li", {}, element("button", { type: "button", onclick: () => this.seek(event.t) }, `${event.t.toFixed(2)} s`), ` ${positive(event.what)}`,
      )), ...(clip.events.length ? [] : [element("li", {}, "No event.")]), ...(clip.contact ? [element("li", {}, clip.contact)] : [])),
      element("p", {}, element("code", {}, clip.command)),
    ));
    const heads = this.sides.map(({ clip }) => element("th", { scope: "col" }, clip.title));
    const table = element("table", {}, element("thead", {}, element("tr", {}, element("td", {}), ...heads)), element("tbody", {}, ...rows));
    // A report has many sections, so there they are folded until the reader opens them.
    const open = this.details ? this.details.open : !this.root.parentElement?.hasAttribute("data-viewer");
    this.details = element("details", { open }, element("summary", {}, "Events and parameters"), element("div", { class: "view-columns" }, ...events), ...(names.length ? [table] : []));
    this.facts.replaceChildren(this.details);
  }

  resize() {
    const width = this.stage.clientWidth, height = this.stage.clientHeight;
    if (!this.renderer || width === 0) return;
    this.renderer.setPixelRatio(Math.min(2, devicePixelRatio || 1));
    this.renderer.setSize(width, height, false);
    this.draw();
  }

  draw() {
    if (!this.renderer || this.pending || this.worlds.length === 0) return;
    this.pending = true;
    requestAnimationFrame(() => {
      this.pending = false;
      this.paint();
    });
  }

  paint() {
    const size = this.renderer.getSize(new Vector3());
    const n = this.worlds.length;
    const wide = Math.floor(size.x / n);
    this.worlds.forEach((world, i) => {
      this.camera.aspect = (wide - 1) / size.y;
      // A narrow view keeps the same horizontal extent.
      this.camera.fov = this.camera.aspect < 1.2 ? 2 * Math.atan(Math.tan(0.3142) * (1.2 / this.camera.aspect)) * (180 / Math.PI) : 36;
      this.camera.updateProjectionMatrix();
      this.renderer.setViewport(i * wide, 0, wide - 1, size.y);
      this.renderer.setScissor(i * wide, 0, wide - 1, size.y);
      this.renderer.render(world.scene, this.camera);
    });
  }

  seek(t) {
    this.now = Math.min(this.end, Math.max(0, t));
    this.pose();
  }

  pose() {
    const t = this.now;
    this.worlds.forEach((world) => world.show(t));
    [...this.films.children].forEach((image, i) => {
      const film = this.sides[i].clip.film ?? [];
      const [at] = locate(film.map(([time]) => time), t);
      const source = film[at] ? `data:image/jpeg;base64,${film[at][1]}` : "";
      if (source && image.src !== source) image.src = source;
    });
    this.slider.value = t;
    this.slider.setAttribute("aria-valuetext", `${t.toFixed(2)} seconds`);
    this.clock.textContent = `${t.toFixed(2)} / ${this.end.toFixed(2)} s`;
    this.sides.forEach(({ clip, motion }, i) => {
      const phase = clip.phases.filter((p) => p.t <= t + 1e-9).pop();
      const over = t >= motion.end - 1e-6 ? `ended at ${figure(clip.time_s)} s` : "";
      const name = phase ? phase.what.toLowerCase().replace(/_/g, " ") : "";
      const label = this.labels.children[i]?.querySelector(".view-phase");
      if (label) label.textContent = [name, over].filter(Boolean).join(" · ");
    });
    this.chart?.show(t);
    this.draw();
  }

  toggle() {
    if (this.playing) this.pause();
    else {
      if (this.now >= this.end - 1e-6) this.now = 0;
      this.playing = true;
      this.play.textContent = "❚❚";
      this.play.setAttribute("aria-label", "Pause");
      this.play.title = "Pause";
      let last = performance.now();
      const tick = (time) => {
        if (!this.playing) return;
        this.seek(this.now + (this.speed * Math.max(0, time - last)) / 1000);
        last = time;
        if (this.now >= this.end - 1e-6) this.pause();
        else requestAnimationFrame(tick);
      };
      requestAnimationFrame(tick);
    }
  }

  pause() {
    this.playing = false;
    this.play.textContent = "▶";
    this.play.setAttribute("aria-label", "Play");
    this.play.title = "Play";
  }

  nudge(frames) {
    this.pause();
    this.seek(this.now + frames / 30);
  }

  key(event) {
    const inField = event.target instanceof HTMLSelectElement;
    const onButton = event.target instanceof HTMLButtonElement || event.target.type === "checkbox";
    const acts = {
      " ": () => !onButton && this.toggle(), k: () => this.toggle(),
      ArrowLeft: () => this.nudge(event.shiftKey ? -10 : -1), ArrowRight: () => this.nudge(event.shiftKey ? 10 : 1),
      Home: () => this.seek(0), End: () => this.seek(this.end),
    };
    const act = acts[event.key];
    if (!act || inField || (onButton && event.key === " ")) return;
    event.preventDefault();
    act();
  }
}
