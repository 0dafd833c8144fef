"use strict";
// Everything shown comes in as text, never as HTML: names are the senders'.
const $ = id => document.getElementById(id);
function el(tag, attributes, ...children) {
  const node = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes || {})) node.setAttribute(name, value);
  node.append(...children);
  return node;
}
const percent = x => x == null ? "-" : (100 * x).toFixed(1) + " %";
const whole = x => Math.round(x).toLocaleString("en");
const short = x => String(Number(x.toPrecision(3)));
const time = s => new Date(1000 * s).toISOString().replace("T", " ").slice(0, 19);
const range = ([low, high]) => percent(low) + " to " + percent(high);
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
  if (!d.levels) return el("div", { class: "level" }, el("span", {}, d.label), el("span", { class: "dim" }, d.because), el("span"));
  const [, critical] = d.levels, full = d.standing === "critical" ? 1 : share(critical);
  const track = el("span", { class: "track", role: "meter", "aria-valuemin": 0, "aria-valuemax": 100,
    "aria-valuenow": Math.round(100 * full), "aria-label": d.label + ": evidence relative to its critical limit" },
    el("i", { style: `width:${100 * full}%`, ...(d.standing ? { class: "over" } : {}) }));
  return el("div", { class: "level" }, el("span", {}, d.label), track,
    el("span", { class: d.standing || "dim" }, d.standing || whole(critical[0]) + " / " + whole(critical[1])));
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
    ...r.detectors.map(detector), ...r.outside.map(outside));
}
function outside(o) {
  const range = o.numbers && (o.numbers[0] < o.numbers[1] ? `${short(o.numbers[0])} to ${short(o.numbers[1])}` : short(o.numbers[0]));
  const valid = o.validated && (o.validated.range ? o.validated.range.map(short).join(" to ") : o.validated.words.join(", "));
  return el("div", { class: "warning" }, o.parameter
    ? `${o.parameter} ${range || o.word || ""} in ${whole(o.cycles)} cycles; validated: ${valid}`
    : `${whole(o.cycles)} cycles with a combination of parameters outside the validated region`);
}
function alarm(a) {
  const since = a.since && `Since cycle ${whole(a.since.cycle)} (${time(a.since.time_s)} UTC), 95 %: ` +
    `${whole(a.since.cycles_95[0])}${a.since.or_before ? " or before" : ""} to ${whole(a.since.cycles_95[1])}.`;
  return el("section", { class: "card" },
    el("h3", {}, el("span", {}, `${a.recipe}: ${a.what}`),
      el("span", { class: a.happening === "raised" ? a.level : "dim" }, a.happening === "raised" ? a.level : "cleared")),
    el("div", { class: "dim" }, `${time(a.time_s)} UTC, ${a.rule === "paper" ? "the paper's rule" : "detector"}, cycle ${whole(a.cycle)} ` +
      `(${a.cycle_id}), ${a.robot}`),
    ...(since ? [el("div", {}, since)] : []), el("div", {}, a.how_sure),
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
    el("td", { class: c.success ? "fine" : "critical" }, c.success ? "success" : c.failure_mode || "failure"),
    el("td", {}, c.cycle_time_s == null ? "-" : c.cycle_time_s.toFixed(2) + " s"));
}
const fill = (id, all, make, nothing) =>
  $(id).replaceChildren(...(all.length ? all.map(make) : [el("p", { class: "dim" }, nothing)]));
async function refresh() {
  try {
    const [s, f] = await Promise.all([get("/v1/status"), get("/v1/fleet")]);
    $("body").hidden = false;
    $("promise").textContent = `Without a change, the mean number of cycles to a false warning is at least ${whole(s.promised_cycles[0])}, ` +
      `to a false critical alarm at least ${whole(s.promised_cycles[1])}, over all metrics and recipes together. ` +
      "Bars show the evidence of a detector relative to its critical limit, on a logarithmic scale.";
    fill("recipes", s.recipes, recipe, "No cycle has arrived yet.");
    const [ours, papers] = ["detector", "paper"].map(rule => s.alarms.filter(a => a.rule === rule));
    fill("alarms", ours, alarm, "No alarms.");
    fill("paper", papers, alarm, "No alarms.");
    $("papers").textContent = `Alarms of the paper's rule (${whole(papers.length)})`;
    fleet(f);
    $("cycles").replaceChildren(...s.cycles.map(cycle));
    const i = s.intake;
    $("intake").textContent = `Since the start: ${whole(i.accepted)} cycles accepted, ${whole(i.duplicates)} duplicates, ` +
      `${whole(i.out_of_order)} out of order (${whole(i.late)} late), ${whole(i.outside)} outside the validated region, ` +
      `${whole(i.refused)} refused. ${whole(s.recipes_known)} recipes.`;
    $("state").textContent = "live";
    $("state").className = "fine";
  } catch (error) {
    $("state").textContent = error.message || "the monitor does not respond";
    $("state").className = "critical";
  }
}
refresh();
setInterval(() => document.hidden || refresh(), 3000);
