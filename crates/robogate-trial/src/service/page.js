"use strict";
// The token is in the fragment, which a browser sends to no server. It is kept for a reload of this tab.
const token = new URLSearchParams(location.hash.slice(1)).get("token") || sessionStorage.getItem("token") || "";
sessionStorage.setItem("token", token);
const $ = (id) => document.getElementById(id);
const LATE = 1500; // A request without an answer after so many milliseconds is sent again, once.
let state = null;
let operator = sessionStorage.getItem("operator") || "";
let picked = { outcome: null, stage: null };
let correcting = false;
let busy = false;
let shown = "";
let clockAt = 0;
let before = ""; // The set-up of the last trial.

const words = (name) => name.replaceAll("_", " ");

const blocked = () => busy || localStorage.getItem("waiting") !== null;

function alarm(text) {
  $("alarm").textContent = text;
  $("alarm").hidden = !text;
}

async function call(path, body) {
  const stop = new AbortController();
  const timer = setTimeout(() => stop.abort(), LATE);
  try {
    const reply = await fetch(path, {
      method: body ? "POST" : "GET",
      headers: { Authorization: `Bearer ${token}`, "Content-Type": "application/json" },
      body,
      signal: stop.signal,
    });
    return { status: reply.status, document: await reply.json() };
  } finally {
    clearTimeout(timer);
  }
}

const newId = () => Array.from(crypto.getRandomValues(new Uint8Array(12)), (byte) => byte.toString(16).padStart(2, "0")).join("");

// A tap that has no answer yet is kept, also over a reload: with the same identifier it is recorded once.
async function send(command) {
  const body = JSON.stringify({ id: newId(), ...command });
  localStorage.setItem("waiting", body);
  await deliver(body);
}

async function deliver(body) {
  busy = true;
  draw();
  for (let tries = 0; tries < 2; tries += 1) {
    try {
      const { status, document: answer } = await call("/v1/do", body);
      busy = false;
      localStorage.removeItem("waiting");
      alarm(status === 200 ? "" : `Not recorded: ${answer.error}`);
      if (status === 200) {
        reset();
      }
      await look();
      return;
    } catch {
      alarm(tries ? "Not recorded yet: no connection. It is sent again when the connection is back." : "No answer. Sending again.");
    }
  }
  busy = false;
  draw();
}

function reset() {
  picked = { outcome: null, stage: null };
  correcting = false;
  for (const id of ["measured", "notes", "because", "reason"]) {
    $(id).value = "";
  }
}

async function look() {
  try {
    const { status, document: found } = await call("/v1/state");
    if (status !== 200) {
      alarm(found.error);
      return;
    }
    state = found;
    clockAt = performance.now();
    const waiting = localStorage.getItem("waiting");
    if (waiting && !busy) {
      await deliver(waiting);
      return;
    }
    if (!waiting && $("alarm").textContent.startsWith("No connection")) {
      alarm("");
    }
  } catch {
    if (!localStorage.getItem("waiting")) {
      alarm("No connection to the server.");
    }
  }
  draw();
}

function button(text, kind, press) {
  const made = document.createElement("button");
  made.type = "button";
  made.textContent = text;
  made.className = kind;
  made.disabled = blocked();
  made.addEventListener("click", press);
  return made;
}

function choices(place, values, key) {
  $(place).replaceChildren(
    ...values.map((value) => {
      const made = button(words(value), "", () => {
        picked[key] = value;
        if (key === "outcome" && value === "success") {
          picked.stage = null;
        }
        shown = "";
        draw();
      });
      made.setAttribute("aria-pressed", String(picked[key] === value));
      return made;
    }),
  );
}

function draw() {
  if (!state) {
    return;
  }
  tick();
  const now = JSON.stringify([state.phase, state.code, state.connections, state.last, state.repeated, picked, operator, blocked(), correcting]);
  if (now === shown) {
    return;
  }
  shown = now;
  const { phase, code } = state;
  if (phase === "running") {
    before = JSON.stringify(state.setup);
  }
  const live = phase !== "finished";
  $("count").textContent = live ? `Trial ${state.trial} of at most ${state.most_trials}` : "Study";
  $("pause").hidden = phase !== "ready" && phase !== "paused";
  $("pause").textContent = phase === "paused" ? "Go on" : "Pause";
  $("pause").disabled = blocked();
  $("entry").hidden = Boolean(operator);
  $("trial").hidden = !operator;
  $("operators").replaceChildren(...state.operators.map((name) => button(name, "", () => enter(name))));
  $("named").hidden = state.operators.length > 0;
  const result = phase === "stopped" || correcting;
  $("code").textContent = correcting ? `Correct ${state.last.code}` : live ? `Trial ${code}` : "The study has ended";
  const say = {
    ready: JSON.stringify(state.setup) === before ? "Restore the same set-up, then press Start." : "Make this set-up, then press Start.",
    running: "The robot runs.",
    stopped: "What happened?",
    paused: "Paused.",
    finished: "No further trial is needed. The owner of the study has the report.",
  };
  const again = state.repeated && phase === "ready" ? `The last trial was invalid (${state.repeated}) and is repeated. ` : "";
  $("say").textContent = correcting ? "The last result is replaced, and the reason recorded." : again + say[phase];
  $("setup").hidden = correcting || !live;
  $("setup").replaceChildren(
    ...state.setup.flatMap(([name, value]) => {
      const pair = [document.createElement("dt"), document.createElement("dd")];
      pair[0].textContent = words(name);
      pair[1].textContent = value;
      return pair;
    }),
  );
  $("robot").hidden = phase !== "running" || state.connections === null || state.connections > 0;
  $("robot").textContent = "The robot is not connected yet.";
  const actions = [];
  if (phase === "ready" && !correcting) {
    actions.push(button("Start", "main", () => send({ do: "start", code, operator })));
  } else if (phase === "running") {
    actions.push(button("Stop", "stop", () => send({ do: "stop", code })));
  }
  $("actions").replaceChildren(...actions);
  $("details").hidden = !result;
  choices("outcomes", ["success", ...state.modes], "outcome");
  choices("stages", state.stages, "stage");
  $("reached").hidden = !state.stages.length || !picked.outcome || picked.outcome === "success";
  $("measure").hidden = !state.measure;
  $("measure").firstElementChild.textContent = `${words(state.measure || "")} (optional)`;
  $("why").hidden = !correcting;
  $("send").disabled = blocked() || !picked.outcome;
  $("voiding").hidden = phase !== "running" && (phase !== "stopped" || correcting);
  $("voidsay").textContent =
    phase === "running"
      ? "Something outside of the robot disturbs this trial: declare it invalid now, before Stop. It is repeated."
      : "Declared invalid now, after Stop, this trial counts as a failure.";
  $("void").disabled = blocked();
  $("correct").hidden = !state.last || correcting || phase === "running" || phase === "stopped";
}

function tick() {
  const running = state && state.phase === "running" && state.elapsed_s !== null;
  const ended = state && state.phase === "stopped" && state.duration_s !== null;
  $("clock").hidden = !running && !ended;
  if (running) {
    $("clock").textContent = `${(state.elapsed_s + (performance.now() - clockAt) / 1000).toFixed(1)} s`;
  } else if (ended) {
    $("clock").textContent = `${state.duration_s.toFixed(1)} s`;
  }
}

function enter(name) {
  operator = name.trim();
  sessionStorage.setItem("operator", operator);
  draw();
}

$("named").addEventListener("submit", (event) => {
  event.preventDefault();
  enter($("name").value);
});
$("pause").addEventListener("click", () => send({ do: state.phase === "paused" ? "resume" : "pause" }));
$("correct").addEventListener("click", () => {
  correcting = true;
  draw();
});
$("voiding").addEventListener("submit", (event) => {
  event.preventDefault();
  send({ do: "void", code: state.code, reason: $("reason").value });
});
$("details").addEventListener("submit", (event) => {
  event.preventDefault();
  const success = picked.outcome === "success";
  const result = { success, notes: $("notes").value };
  if (!success) {
    result.mode = picked.outcome;
  }
  if (picked.stage) {
    result.stage = picked.stage;
  }
  const text = $("measured").value.trim().replace(",", ".");
  if (text) {
    const number = Number(text);
    if (!Number.isFinite(number)) {
      alarm("The measured value is not a number.");
      return;
    }
    result.measured = number;
  }
  send(correcting ? { do: "correct", code: state.last.code, result, reason: $("because").value } : { do: "result", code: state.code, result });
});
setInterval(look, 1000);
setInterval(tick, 100);
look();
