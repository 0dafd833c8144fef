// The page of the monitor that plays the simulated episodes most similar to the failed cycle before an alarm.

import { element } from "./explorer/dom.js";
import { figure } from "./explorer/data.js";

/** The viewer of the script before this one (web/src/replays.js). */
const Viewer = window.robogateViewer;
/** Times that a busy monitor is asked again, once a second. */
const MOST_TRIES = 30;

const query = new URLSearchParams(location.hash.slice(1));
/** Names of failure modes for a person. */
const readable = (word) => word.replace(/_/g, " ");

async function get(path) {
  // The page of the monitor keeps the token in this tab.
  const token = sessionStorage.getItem("token");
  for (let tries = 1; ; tries++) {
    const answer = await fetch(path, token ? { headers: { authorization: `Bearer ${token}` } } : {});
    if (answer.ok) return answer.json();
    if (answer.status === 401) throw new Error("a token is required. Enter it on the page of the monitor, and open this page from there");
    if (answer.status !== 503 || tries >= MOST_TRIES) throw new Error((await answer.json()).error);
    await new Promise((done) => setTimeout(done, 1000));
  }
}

class Replay {
  constructor(root) {
    this.status = element("p", { class: "sub", role: "status" }, "The cycles before the alarm are read …");
    this.choices = element("ol", { class: "watch-list" });
    this.stage = element("div", { class: "watch-view" });
    this.beside = element("p", { class: "text" });
    this.table = element("div", { class: "scroll" });
    root.append(
      element("header", { class: "top" }, element("p", { class: "brand" }, element("b", {}, "RoboGate"), " ", element("a", { href: "/" }, "monitor")),
        element("h1", {}, "Similar simulated episodes"), this.status),
      element("main", {}, element("div", { class: "watch" }, element("div", {}, this.choices, this.table), element("div", {}, element("h2", { class: "x-hidden" }, "Replay"), this.stage, this.beside))),
    );
  }

  async start() {
    try {
      const [recipe, until] = ["recipe", "until"].map((name) => encodeURIComponent(query.get(name) ?? ""));
      this.around = await get(`/v1/cycles?recipe=${recipe}&until=${until}`);
      const { nearest, nearest_failure: failure, failure_mode: mode, like } = this.around;
      const alike = failure && mode && failure.outcome === mode;
      const all = [[alike ? `Nearest ${readable(mode)}` : "Nearest failure", failure], ["Nearest episode", nearest]].filter(([, one], at) => one && (at === 0 || one.index !== failure?.index));
      if (all.length === 0) {
        this.status.textContent = like === null
          ? "No failed cycle before this alarm reports parameters, so no simulated episode can be compared with it."
          : "The monitor has no simulated episodes for this recipe. Start it with --episodes RUN.";
        return;
      }
      this.cycle = this.around.cycles.find((cycle) => cycle.id === like);
      this.status.textContent = `Failed cycle ${like} of ${query.get("recipe")} before the alarm at cycle ${query.get("until")}: ` +
        `${readable(this.cycle?.failure_mode ?? "failure")}. The simulated episodes have the most similar parameters.` +
        (failure && mode && !alike ? ` No simulated episode ends with ${readable(mode)}.` : "");
      this.choices.replaceChildren(...all.map(([title, one]) => this.choice(title, one)));
      const wanted = all.findIndex(([, one]) => String(one.index) === query.get("episode"));
      await this.open(all[Math.max(0, wanted)][1]);
    } catch (error) {
      this.status.textContent = `The episodes cannot be shown: ${error.message}.`;
    }
  }

  choice(title, one) {
    const passed = one.outcome === "success";
    const button = element(
      "button", { type: "button", "data-index": one.index, "aria-pressed": "false", onclick: () => this.open(one) },
      element("span", { class: "watch-title" }, title), element("span", { class: passed ? "chip good" : "chip bad" }, readable(one.outcome)),
      element("span", { class: "watch-why" }, `Episode ${one.index}. Difference ${figure(one.distance)}: 0 is equal, 1 a whole range apart in every parameter.`),
    );
    return element("li", {}, button);
  }

  /** Recomputes and plays an episode, beside the passing one with the most similar parameters. */
  async open(one) {
    for (const button of this.choices.querySelectorAll("button")) button.setAttribute("aria-pressed", String(button.dataset.index === String(one.index)));
    this.compare(one);
    const ticket = (this.ticket = (this.ticket ?? 0) + 1);
    this.beside.textContent = `Episode ${one.index} is being recomputed …`;
    try {
      if (one.run === null) throw new Error("its run cannot be replayed here");
      const { reel, twin } = await get(`/v1/replay?run=${one.run}&index=${one.index}`);
      if (ticket !== this.ticket) return;
      this.stage.hidden = false;
      this.viewer ??= new Viewer(this.stage, reel);
      if (this.viewer.reel !== reel) this.viewer.load(reel);
      await this.viewer.open(0, twin?.at);
      const shown = typeof twin?.at === "number";
      this.beside.textContent = shown ? `Beside it: episode ${twin.index}, the passing episode with the most similar parameters. ${twin.differences}` : "";
    } catch (error) {
      if (ticket !== this.ticket) return;
      this.stage.hidden = true;
      this.beside.textContent = `Episode ${one.index} cannot be shown: ${error.message}. Command: ${one.command}`;
    }
  }

  /** Parameters of the cycle and of the episode. */
  compare(one) {
    const text = (value) => (typeof value === "number" ? figure(value) : value === undefined ? "–" : String(value));
    const cell = (value) => element("td", { class: "num" }, text(value));
    const rows = one.parameters.map((name) => element("tr", {}, element("th", { scope: "row" }, readable(name)), cell(this.cycle?.parameters?.[name]), cell(one.values[name])));
    this.table.replaceChildren(element(
      "table", {}, element("caption", { class: "x-hidden" }, "Parameters of the cycle and of the episode"),
      element("thead", {}, element("tr", {}, element("td", {}), element("th", { scope: "col", class: "num" }, "cycle"), element("th", { scope: "col", class: "num" }, `episode ${one.index}`))),
      element("tbody", {}, ...rows),
    ));
  }
}

const root = document.getElementById("replay");
if (root) void new Replay(root).start();
// Another alarm in the address is another page.
addEventListener("hashchange", () => location.reload());
