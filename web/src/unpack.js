// Reads the packed streams of a reel: raw DEFLATE in base64. The format is described in crates/robogate-replay/src/pack.rs.

/** The bytes of a packed text. */
export async function inflate(text) {
  const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate-raw"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/** The solids that the clips of a reel share. */
export async function solidsOf(reel) {
  return JSON.parse(new TextDecoder().decode(await inflate(reel.solids)));
}

/** Reads variable-length integers one by one. */
function reader(bytes) {
  let at = 0;
  return () => {
    let value = 0, scale = 1;
    for (;;) {
      if (at >= bytes.length) throw new RangeError("the packed data end too early");
      const byte = bytes[at++];
      value += (byte & 0x7f) * scale;
      if (byte < 0x80) break;
      scale *= 128;
    }
    return value % 2 ? -(value + 1) / 2 : value / 2;
  };
}

/** All integers of a packed text. */
export async function integersOf(text) {
  const bytes = await inflate(text);
  const count = bytes.reduce((n, byte) => n + (byte < 0x80 ? 1 : 0), 0);
  const integer = reader(bytes);
  return Float64Array.from({ length: count }, integer);
}

/** The motion and the signals of a clip. */
export async function motionOf(clip) {
  const bytes = await inflate(clip.data);
  const integer = reader(bytes);
  const steps = (n, unit) => {
    const out = new Float64Array(n);
    for (let i = 0, last = 0; i < n; i++) out[i] = (last += integer()) * unit;
    return out;
  };
  const smooth = (n, unit) => {
    const out = new Float32Array(n);
    for (let i = 0, last = 0, slope = 0; i < n; i++) {
      slope += integer();
      last += slope;
      out[i] = last * unit;
    }
    return out;
  };
  const [length, quaternion, force, time] = clip.units;
  const times = steps(clip.frames, time);
  const poses = [];
  for (let body = 0; body < clip.bodies; body++) {
    const channels = [];
    for (let i = 0; i < 7; i++) channels.push(smooth(clip.frames, i < 3 ? length : quaternion));
    poses.push(channels);
  }
  const contacts = [];
  for (let frame = 0; frame < clip.frames; frame++) {
    const points = [];
    for (let n = integer(); n > 0; n--) {
      const kind = integer();
      const position = [integer() * length, integer() * length, integer() * length];
      points.push({ kind, position, force: [integer() * force, integer() * force, integer() * force] });
    }
    contacts.push(points);
  }
  const ticks = steps(clip.ticks, time);
  const signals = clip.signals.map((signal) => {
    const n = signal.frames ? clip.frames : clip.ticks;
    const codes = steps(n, 1);
    const unit = signal.high > signal.low ? (signal.high - signal.low) / 4000 : 0;
    const values = Array.from(codes, (code) => (code === 0 ? null : signal.low + (code - 1) * unit));
    return { ...signal, times: signal.frames ? times : ticks, values };
  });
  const end = Math.max(times.length ? times[times.length - 1] : 0, ticks.length ? ticks[ticks.length - 1] : 0);
  return { times, poses, contacts, ticks, signals, end };
}

/** The last index of ascending times at or before a time, and the fraction of the way to the next one. */
export function locate(times, t) {
  let low = 0, high = times.length - 1;
  if (high < 0) return [0, 0];
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (times[middle] <= t) low = middle;
    else high = middle - 1;
  }
  if (low + 1 >= times.length) return [low, 0];
  const share = (t - times[low]) / (times[low + 1] - times[low]);
  return [low, Math.min(1, Math.max(0, share))];
}
