"use strict";
// Everything shown comes in as text, never as HTML: names are the senders'.
const $ = id => document.getElementById(id);
// The policy of the page forbids styles in attributes; scripts may set them.
function assign(node, attributes) {
  for (const [name, value] of Object.entries(attributes || {})) {
    if (name === "style") node.style.cssText = value; else node.setAttribute(name, value);
  }
  return node;
}
function el(tag, attributes, ...children) {
  const node = assign(document.createElement(tag), attributes);
  node.append(...children);
  return node;
}
// A percent sign stays on the line of its number.
const percent = x => x == null ? "-" : (100 * x).toFixed(1) + "\u00a0%";
const whole = x => Math.round(x).toLocaleString("en");
const short = x => String(Number(x.toPrecision(3)));
const time = s => new Date(1000 * s).toISOString().replace("T", " ").slice(0, 19);
const range = ([low, high]) => percent(low) + " to " + percent(high);
// A sentence of the monitor, whose names stand between backticks.
const said = text => text.replaceAll(" %", "\u00a0%").split("`").map((part, i) => i % 2 ? el("code", {}, part) : part);
let token = sessionStorage.getItem("token") || "";
async function get(path) {
  const answer = await fetch(path, token ? { headers: { authorization: "Bearer " + token } } : {});
  if (answer.status === 401) { $("login").hidden = false; $("body").hidden = true; throw new Error("a token is required"); }
  if (!answer.ok) throw new Error((await answer.json()).error);
  return answer.json();
}
$("login").addEventListener("submit", event => {
  event.preventDefault();
  token = $("token").value;
  sessionStorage.setItem("token", token);
  $("login").hidden = true;
  refresh();
});
// Evidence grows by factors, so the bar has a logarithmic scale. It is full at the limit.
const share = ([evidence, limit]) => Math.max(0, Math.min(1, Math.log1p(evidence) / Math.log1p(limit)));
function detector(d) {
  if (!d.levels) return el("div", { class: "level" }, el("span", {}, d.label), el("span", { class: "dim because" }, d.because));
  const [, critical] = d.levels, full = d.standing === "critical" ? 1 : share(critical);
  const track = el("span", { class: "track", role: "meter", "aria-valuemin": 0, "aria-valuemax": 100,
    "aria-valuenow": Math.round(100 * full), "aria-label": d.label + ": evidence relative to its critical limit" },
    el("i", { style: `width:${100 * full}%`, ...(d.standing ? { class: "over" } : {}) }));
  return el("div", { class: "level" }, el("span", {}, d.label), track,
    el("span", { class: d.standing || "dim" }, d.standing || whole(critical[0]) + " / " + whole(critical[1])));
}
const SVG = "http://www.w3.org/2000/svg";
function draw(tag, attributes, text) {
  const node = assign(document.createElementNS(SVG, tag), attributes);
  if (text != null) node.textContent = text;
  return node;
}
const WIDE = 340, HIGH = 114, LEFT = 46, TOP = 12, LOW = HIGH - 20;
const hint = text => draw("title", {}, text);
// The frame of a chart over the cycles of a recipe, with the marks of alarms.
function frame(charts, marks, label) {
  const svg = draw("svg", { viewBox: `0 0 ${WIDE} ${HIGH}`, role: "img", "aria-label": label });
  const last = charts.cycles[charts.cycles.length - 1], first = Math.max(1, charts.cycles[0] - (charts.cycles[1] - charts.cycles[0] || 0));
  const x = cycle => LEFT + (WIDE - LEFT - 4) * (cycle - first) / Math.max(1, last - first);
  svg.append(draw("line", { class: "frame", x1: LEFT, x2: WIDE - 4, y1: LOW, y2: LOW }),
    draw("text", { x: LEFT, y: HIGH - 6 }, "cycle " + whole(first)), draw("text", { x: WIDE - 4, y: HIGH - 6, "text-anchor": "end" }, whole(last)));
  for (const a of marks) {
    if (a.cycle < first) continue;
    const kind = a.happening === "raised" ? a.level : "cleared";
    const line = draw("line", { class: "mark " + kind, x1: x(a.cycle), x2: x(a.cycle), y1: TOP, y2: LOW });
    line.append(hint(`${kind}, cycle ${whole(a.cycle)}: ${a.what}`));
    svg.append(line);
  }
  return [svg, x];
}
function axis(svg, y, values, show) {
  for (const value of values) svg.append(draw("text", { x: LEFT - 5, y: y(value) + 4, "text-anchor": "end" }, show(value)),
    draw("line", { class: "frame", x1: LEFT - 3, x2: LEFT, y1: y(value), y2: y(value) }));
}
// A round number of at least x: 1, 2 or 5 times a power of ten.
function round(x) {
  const power = 10 ** Math.floor(Math.log10(x || 1e-3));
  return power * [1, 2, 5, 10].find(step => step * power >= x * 0.999);
}
function metric(charts, m, marks) {
  const show = m.share ? x => String(Number((100 * x).toPrecision(3))) + "\u00a0%" : x => String(Number(x.toPrecision(3))) + "\u00a0s";
  const seen = [...m.values, ...m.intervals_95.flatMap(i => i || []), ...(m.bounds || []), m.baseline].filter(x => x != null);
  let low = 0, high = Math.min(m.share ? 1 : Infinity, round(Math.max(...seen)));
  if (!m.share) {
    const room = Math.max(0.05, 0.15 * (Math.max(...seen) - Math.min(...seen)));
    [low, high] = [Math.max(0, Math.min(...seen) - room), Math.max(...seen) + room];
  }
  const y = value => LOW - (LOW - TOP) * (Math.min(value, high) - low) / (high - low || 1);
  const now = m.values.findLast(x => x != null);
  const base = m.baseline == null ? "baseline being learnt or not given" : `baseline ${show(m.baseline)}` +
    (m.bounds ? ` (${show(m.bounds[0])} to ${show(m.bounds[1])})` : "");
  const [svg, x] = frame(charts, marks, `${m.label} over the cycles: last ${show(now)}, ${base}`);
  axis(svg, y, [low, high], show);
  if (m.bounds) svg.prepend(draw("rect", { class: "bounds", x: LEFT, width: WIDE - LEFT - 4, y: y(m.bounds[1]),
    height: Math.max(1, y(m.bounds[0]) - y(m.bounds[1])) }));
  if (m.baseline != null) svg.append(draw("line", { class: "base", x1: LEFT, x2: WIDE - 4, y1: y(m.baseline), y2: y(m.baseline) }));
  m.values.forEach((value, i) => {
    if (value == null) return;
    const at = x(charts.cycles[i]), interval = m.intervals_95[i];
    if (interval) svg.append(draw("line", { class: "whisker", x1: at, x2: at, y1: y(interval[0]), y2: y(interval[1]) }));
    const dot = draw("circle", { class: "dot", cx: at, cy: y(value), r: 2 });
    dot.append(hint(`up to cycle ${whole(charts.cycles[i])} (${time(charts.times_s[i])} UTC): ${show(value)}` +
      (interval ? `, 95 %: ${show(interval[0])} to ${show(interval[1])}` : "")));
    svg.append(dot);
  });
  return el("figure", {}, el("figcaption", {}, m.label + " ", el("span", { class: "dim" }, `last ${show(now)}; ${base}`)), svg);
}
// Evidence grows by factors, so its axis is logarithmic.
const LEAST = 1e-4;
function evidence(charts, marks, promised) {
  const y = share => TOP + (LOW - TOP) * Math.log10(Math.max(share, LEAST)) / Math.log10(LEAST);
  const [svg, x] = frame(charts, marks, "evidence of each detector as a share of the limit of a warning, on a logarithmic scale");
  axis(svg, y, [1, 1e-2, 1e-4], share => ({ 1: "limit", 0.01: "1 %", 0.0001: "0.01 %" })[share]);
  svg.append(draw("line", { class: "limit", x1: LEFT, x2: WIDE - 4, y1: y(1), y2: y(1) }));
  const keys = [];
  charts.evidence.forEach((e, i) => {
    const line = draw("polyline", { class: "course", style: `stroke: var(--l${i % 8})`,
      points: e.shares.map((share, at) => `${x(charts.cycles[at]).toFixed(1)},${y(share).toFixed(1)}`).join(" ") });
    line.append(hint(e.label));
    svg.append(line);
    keys.push(el("span", {}, el("span", { class: "key", style: `background: var(--l${i % 8})` }), e.label));
  });
  return el("figure", {}, el("figcaption", {}, "evidence for a change ", el("span", { class: "dim" },
    `Without a change, a warning (all metrics and recipes together) is raised after at least ${whole(promised[0])} cycles on average.`)), svg,
    el("div", { class: "keys" }, ...keys));
}
// Parts that the reader opened stay open when the page is drawn again.
const opened = new Map();
function fold(key, open, title, ...children) {
  const node = el("details", (opened.has(key) ? opened.get(key) : open) ? { open: "" } : {}, el("summary", { class: "dim", "data-key": key }, title), ...children);
  node.addEventListener("toggle", () => opened.set(key, node.open));
  return node;
}
function course(r) {
  if (!r.charts || !r.charts.cycles.length) return [];
  const ours = current.alarms.filter(a => a.recipe === r.recipe);
  const figures = r.charts.metrics.map(m => metric(r.charts, m, ours.filter(a => a.metric === m.metric)));
  if (r.charts.evidence.length) figures.push(evidence(r.charts, ours, current.promised_cycles));
  return [fold("charts " + r.recipe, r.level != null || current.recipes.length < 4, "Time series", el("div", { class: "charts" }, ...figures))];
}
function recipe(r) {
  const level = r.level || "fine";
  const shown = r.window.cycles ? r.window : r.all;
  return el("section", { class: "card" },
    el("h3", {}, el("span", {}, r.recipe), el("span", { class: level }, r.level || "no alarm")),
    el("div", {}, el("span", { class: "rate" }, percent(shown.rate)), " ",
      el("span", { class: "dim" }, `${range(shown.interval_95)} in the last ${whole(shown.cycles)}; ` +
        `baseline ${r.baseline == null ? "being learnt" : percent(r.baseline)}; all ${whole(r.all.cycles)} cycles ${percent(r.all.rate)}` +
        (r.paper ? `; the paper's rule: ${r.paper}` : ""))),
    ...r.dependence.map(text => el("div", { class: "warning" }, text)),
    ...r.detectors.map(detector), ...r.outside.map(outside), ...course(r));
}
function warnings(w) {
  const e = w.episodes;
  const state = e.suspended ? "suspended" : w.shifted.length ? "partly suspended" : "on";
  return el("section", { class: "card" },
    el("h3", {}, el("span", {}, w.task), el("span", { class: state === "on" ? "fine" : "warning" }, state)),
    el("div", {}, `${whole(e.warned_failures)} failures warned, ${whole(e.missed_failures)} missed; ` +
      `${whole(e.warned_successes)} of ${whole(e.warned_successes + e.quiet_successes)} successes warned (promised: at most ${percent(w.promised)}); ` +
      `${whole(e.stopped)} episodes stopped at a warning; ${whole(w.running)} running`),
    ...(e.suspended ? [el("div", { class: "warning" }, "More successes were warned than promised: calibrate again. No warnings are sent.")] : []),
    ...(w.shifted.length ? [el("div", { class: "warning" }, `No warnings are sent for recipes with an alarm: ${w.shifted.join(", ")}`)] : []),
    ...(w.suppressed ? [el("div", { class: "dim" }, `${whole(w.suppressed)} warnings were not sent, because their recipe had an alarm`)] : []));
}
function outside(o) {
  const range = o.numbers && (o.numbers[0] < o.numbers[1] ? `${short(o.numbers[0])} to ${short(o.numbers[1])}` : short(o.numbers[0]));
  const valid = o.validated && (o.validated.range ? o.validated.range.map(short).join(" to ") : o.validated.words.join(", "));
  return el("div", { class: "warning" }, o.parameter
    ? `${o.parameter} ${range || o.word || ""} in ${whole(o.cycles)} cycles; validated: ${valid}`
    : `${whole(o.cycles)} cycles with a combination of parameters outside the validated region`);
}
// The cycle of an alarm. A warning belongs to an episode that has no cycle yet.
const place = a => a.metric === "warning" ? `episode ${whole(a.cycle)}` : `cycle ${whole(a.cycle)}`;
// Alarms of one metric belong to one event until all of them are cleared.
function events(alarms) {
  const all = [], open = new Map();
  for (const a of [...alarms].reverse()) {
    const key = [a.recipe, a.metric, ["robot", "warning"].includes(a.metric) ? a.robot : ""].join("\n");
    let event = open.get(key);
    if (!event) {
      event = { alarms: [], active: new Set() };
      open.set(key, event);
      all.push(event);
    }
    event.alarms.push(a);
    if (a.happening === "raised") event.active.add(a.level); else event.active.delete(a.level);
    if (!event.active.size) open.delete(key);
  }
  return all.reverse();
}
function happened(event) {
  const raised = event.alarms.filter(a => a.happening === "raised"), lead = raised[raised.length - 1] || event.alarms[event.alarms.length - 1];
  const level = event.active.has("critical") ? "critical" : event.active.has("warning") ? "warning" : null;
  const node = alarm(lead, level || "cleared", level);
  const steps = event.alarms.filter(a => a !== lead || event.alarms.length > 1);
  if (steps.length) node.append(el("ol", { class: "dim" }, ...steps.map(a => el("li", {},
    `${time(a.time_s)} UTC, ${place(a)}: `, ...(a.metric === "warning" && a.happening === "cleared" ? said(a.what) : [`${a.level} ${a.happening}`])))));
  if (lead.metric === "warning") return node;
  const link = el("button", { class: "link", type: "button", "data-key": "around " + lead.id }, "Show its cycles");
  link.addEventListener("click", () => around(lead));
  const known = current.recipes.find(r => r.recipe === lead.recipe);
  node.append(el("div", { class: "links" }, link, ...(known && known.replays ? [el("a", { href: replay(lead), "data-key": "replay " + lead.id },
    "Play the nearest simulated episode")] : [])));
  return node;
}
// The page that plays the simulated episodes most similar to the cycles of an alarm.
const replay = a => `/replay#recipe=${encodeURIComponent(a.recipe)}&until=${encodeURIComponent(a.cycle_id)}`;
// The cycles before an alarm, in place of the last cycles.
let chosen = null;
async function around(a) {
  chosen = { alarm: a, ...(await get(`/v1/cycles?recipe=${encodeURIComponent(a.recipe)}&until=${encodeURIComponent(a.cycle_id)}`)) };
  cycles();
  $("cycles-title").focus();
}
function similar(one, what) {
  return one ? [el("div", {}, `${what}: episode ${one.index}, ${one.outcome.replaceAll("_", " ")}. Difference ${short(one.distance)} of the ranges ` +
    `of ${one.parameters.map(name => name.replaceAll("_", " ")).join(", ")}. `, ...(one.run == null ? [] : [el("a", { href: `${replay(chosen.alarm)}&episode=${one.index}` }, "Play it")])),
    el("pre", {}, el("code", {}, one.command))] : [];
}
// The title of the nearest failure: whether it has the failure mode of the cycle.
function failure() {
  const { nearest_failure: one, failure_mode: mode } = chosen;
  if (!one || !mode) return "Nearest simulated failure";
  return one.outcome === mode ? `Nearest simulated ${mode.replaceAll("_", " ")}` :
    `No simulated episode ends with ${mode.replaceAll("_", " ")}. Nearest simulated failure`;
}
function cycles() {
  const back = el("button", { class: "link", type: "button" }, "Show the last cycles");
  back.addEventListener("click", () => { chosen = null; cycles(); });
  $("cycles-title").textContent = chosen ? "Cycles before the alarm" : "Last cycles";
  $("around").hidden = !chosen;
  if (chosen) {
    const same = chosen.nearest && chosen.nearest_failure && chosen.nearest.index === chosen.nearest_failure.index;
    const near = [...similar(chosen.nearest_failure, failure()), ...(same ? [] : similar(chosen.nearest, "Nearest simulated episode"))];
    $("around").replaceChildren(`${chosen.alarm.recipe}: `, ...said(chosen.alarm.what), ` (cycle ${chosen.alarm.cycle_id}) `, back,
      ...(near.length ? [el("div", {}, `The last failed cycle with parameters is ${chosen.like}${chosen.failure_mode ? ` (${chosen.failure_mode.replaceAll("_", " ")})` : ""}.`), ...near] :
        [el("div", { class: "dim" }, "No simulated episode to compare with: start the monitor with --episodes RUN, and report parameters with the cycles.")]));
  }
  const shown = chosen ? chosen.cycles : current.cycles.filter(c => wanted(c)).slice(0, 20);
  $("cycles").replaceChildren(...shown.map(cycle));
}
// Filters.
let current = null, robotsKnown = new Set();
const wanted = one => (!$("of-recipe").value || one.recipe === $("of-recipe").value) &&
  (!$("of-robot").value || one.robot === $("of-robot").value);
function choices(id, names) {
  const select = $(id), kept = select.value;
  const now = [...select.options].slice(1).map(option => option.value);
  if (now.join("\n") === names.join("\n")) return;
  select.replaceChildren(el("option", { value: "" }, "all"), ...names.map(name => el("option", { value: name }, name)));
  select.value = names.includes(kept) ? kept : "";
}
for (const id of ["of-recipe", "of-robot"]) $(id).addEventListener("change", () => show());
function alarm(a, word, level) {
  const since = a.since && `Since cycle ${whole(a.since.cycle)} (${time(a.since.time_s)} UTC), 95 %: ` +
    `${whole(a.since.cycles_95[0])}${a.since.or_before ? " or before" : ""} to ${whole(a.since.cycles_95[1])}.`;
  return el("section", { class: "card" },
    el("h3", {}, el("span", {}, `${a.recipe}: `, ...said(a.what)),
      el("span", { class: level || "dim" }, word)),
    el("div", { class: "dim" }, `${time(a.time_s)} UTC, ${place(a)}${a.cycle_id && ` (${a.cycle_id})`}, ${a.robot}`),
    ...(since ? [el("div", {}, since)] : []), el("div", {}, ...said(a.how_sure)),
    ...(a.look_at.length ? [el("ul", {}, ...a.look_at.map(text => el("li", {}, text)))] : []));
}
function robots(f) {
  const parts = [el("h3", {}, el("span", {}, f.recipe))];
  if (f.spread) parts.push(el("div", {}, `${f.spread.robots} robots: their success rates differ by a standard deviation of ` +
    `${percent(f.spread.deviation)} beyond chance (95 %: ${range(f.spread.deviation_95)}) around ${percent(f.spread.mean)}`));
  for (const o of f.outliers) parts.push(el("div", { class: o.worse ? "critical" : "fine" },
    `${o.robot} is ${o.worse ? "worse" : "better"} than its peers: ${whole(o.rate.successes)} of ${whole(o.rate.cycles)} ` +
    `succeeded (p ${o.p.toPrecision(2)})`));
  if (!f.outliers.length) parts.push(el("div", { class: "dim" }, "no robot differs significantly from its peers"));
  for (const r of f.robots.slice(0, 5)) parts.push(robot(r));
  if (f.robots.length > 5) parts.push(el("div", { class: "dim" }, `the lowest five of ${whole(f.robots.length)}`));
  return el("section", { class: "card" }, ...parts);
}
const robot = r => el("div", { class: "dim" },
  `${r.robot}: ${percent(r.rate.rate)} (${range(r.rate.interval_95)}) of ${whole(r.rate.cycles)} cycles`);
function fleet(f) {
  const all = el("section", { class: "card" }, el("h3", {}, el("span", {}, `All ${whole(f.robots_known)} robots`)),
    el("div", {}, `${percent(f.all.rate)} of ${whole(f.all.cycles)} cycles succeeded (${range(f.all.interval_95)})`));
  $("fleet").replaceChildren(...(f.robots_known > 1 ? [all, ...f.recipes.map(robots)] : [el("p", { class: "dim" }, "There is one robot.")]));
}
function cycle(c) {
  return el("tr", {}, el("td", {}, time(c.time_s)), el("td", {}, c.robot), el("td", {}, c.recipe),
    el("td", { class: c.success ? "fine" : "critical" }, c.success ? "success" : (c.failure_mode || "failure").replaceAll("_", " ")),
    el("td", {}, c.cycle_time_s == null ? "-" : c.cycle_time_s.toFixed(2) + " s"));
}
const fill = (id, all, make, nothing) =>
  $(id).replaceChildren(...(all.length ? all.map(make) : [el("p", { class: "dim" }, nothing)]));
// The last documents. A page that would not change is not drawn again.
let drawn = "";
async function refresh() {
  try {
    const [s, f] = await Promise.all([get("/v1/status"), get("/v1/fleet")]);
    $("body").hidden = false;
    const text = JSON.stringify([s, f]);
    current = { ...s, fleet: f };
    if (text !== drawn) show();
    drawn = text;
    $("state").textContent = "live";
    $("state").className = "fine";
  } catch (error) {
    $("state").textContent = error.message || "the monitor does not respond";
    $("state").className = "critical";
  }
}
function show() {
    // The focus stays on the element with the same key.
    const focused = document.activeElement && document.activeElement.dataset.key;
    const s = current, f = current.fleet;
    for (const one of [...s.cycles, ...s.alarms]) robotsKnown.add(one.robot);
    for (const one of f.recipes) for (const r of one.robots) robotsKnown.add(r.robot);
    choices("of-recipe", s.recipes.map(r => r.recipe).sort());
    choices("of-robot", [...robotsKnown].sort());
    $("promise").textContent = `Without a change, the mean number of cycles to a false warning is at least ${whole(s.promised_cycles[0])}, ` +
      `to a false critical alarm at least ${whole(s.promised_cycles[1])}, over all metrics and recipes together, ` +
      "if each cycle is as likely to fail as in the baseline, independently of the cycles before it. Recipes whose cycles depend on each other say so. " +
      "Bars show the evidence of a detector relative to its critical limit, on a logarithmic scale.";
    const name = $("of-recipe").value;
    fill("recipes", s.recipes.filter(r => !name || r.recipe === name), recipe, "No cycle has arrived yet.");
    $("warnings-part").hidden = !s.warnings;
    if (s.warnings) fill("warnings", [s.warnings], warnings, "");
    fill("alarms", events(s.alarms.filter(wanted)), happened, "No alarms.");
    fleet(name ? { ...f, recipes: f.recipes.filter(r => r.recipe === name) } : f);
    if (!chosen) cycles();
    const i = s.intake;
    $("intake").textContent = `Since the start: ${whole(i.accepted)} cycles accepted, ${whole(i.duplicates)} duplicates, ` +
      `${whole(i.out_of_order)} out of order (${whole(i.late)} late), ${whole(i.outside)} outside the validated region, ` +
      `${whole(i.refused)} refused. ${whole(s.recipes_known)} recipes.`;
    const again = focused && [...document.querySelectorAll("[data-key]")].find(one => one.dataset.key === focused);
    if (again) again.focus();
}
refresh();
setInterval(() => document.hidden || refresh(), 3000);
