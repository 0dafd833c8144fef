// Where the episodes come from: the server, or this page itself.


import { inflate } from "../unpack.js";

/** Rows of one request. */
const CHUNK = 50000;

/** The numbers of a packed column. The format is described in crates/robogate-replay/src/pack.rs. */
async function floats(text) {
  const planes = await inflate(text);
  const n = planes.length / 4;
  const bytes = new Uint8Array(planes.length);
  for (let plane = 0; plane < 4; plane++) for (let i = 0; i < n; i++) bytes[4 * i + plane] = planes[plane * n + i];
  return new Float32Array(bytes.buffer);
}

/** The episodes that a page contains. */
class Contained {
  constructor(text, reel) {
    this.document = JSON.parse(text);
    this.reel = reel;
  }

  async load(data) {
    data.describe(this.document.state);
    data.append(await Promise.all(this.document.columns.map(floats)));
    data.isPart = data.rows < this.document.state.rows;
    return true;
  }

  async model(run) {
    return this.document.models[run];
  }

  /** Whether an episode can be played. */
  has(run, index) {
    return this.document.episodes.some((one) => one.run === run && one.index === index);
  }

  /** An episode, and its nearest passing twin: { reel, at, twin }. The places are those in the reel. */
  async clip(run, index) {
    const at = this.document.episodes.findIndex((one) => one.run === run && one.index === index);
    if (at < 0) return null;
    this.content ??= JSON.parse(this.reel);
    return { reel: this.content, at, twin: this.document.episodes[at].twin };
  }

  get episodes() {
    return this.document.episodes;
  }
}

/** The episodes of a server. */
class Served {
  constructor(token) {
    this.token = token;
  }

  async get(path) {
    const answer = await fetch(path, { headers: { authorization: `Bearer ${this.token}` } });
    if (answer.ok) return answer;
    const { error } = await answer.json().catch(() => ({ error: answer.statusText }));
    throw new Error(error);
  }

  /** Reads what is new. Returns whether anything is. */
  async load(data) {
    const state = await (await this.get("/v1/state")).json();
    const before = JSON.stringify(data.runs);
    if (data.epoch !== undefined && data.epoch !== state.epoch) data.clear();
    data.describe(state);
    const from = data.rows;
    while (data.rows < state.rows) {
      const start = data.rows, end = Math.min(state.rows, start + CHUNK);
      const bytes = await (await this.get(`/v1/rows?epoch=${state.epoch}&from=${start}&to=${end}`)).arrayBuffer();
      const n = end - start;
      data.append(state.columns.map((_, at) => new Float32Array(bytes, 4 * n * at, n)));
    }
    return data.rows !== from || before !== JSON.stringify(state.runs);
  }

  async model(run) {
    return (await this.get(`/v1/model?run=${run}`)).json();
  }

  has() {
    return true;
  }

  async clip(run, index) {
    const { reel, twin } = await (await this.get(`/v1/clip?run=${run}&index=${index}`)).json();
    return { reel, at: 0, twin };
  }

  get episodes() {
    return null;
  }
}

/** The source of this page. */
export function source() {
  const data = document.getElementById("explorer-data"), reel = document.getElementById("explorer-reel");
  if (data) return new Contained(data.textContent, reel?.textContent ?? "{}");
  const found = /token=([0-9a-f]+)/.exec(location.hash);
  if (found) {
    sessionStorage.setItem("explorer-token", found[1]);
    // The token stays out of the history and of links that are copied from the address bar.
    history.replaceState(null, "", location.pathname);
  }
  return new Served(sessionStorage.getItem("explorer-token") ?? "");
}
