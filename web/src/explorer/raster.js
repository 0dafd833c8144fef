// Lines and dots as counts per pixel and class, so that any number of rows becomes one picture.

/** Steps between no and full opacity. */
const LEVELS = 2047;

/** Milliseconds between two paintings of a picture that is not complete. */
const REPAINT = 120;

/** Whether an incomplete picture is painted now: at once, and then from time to time, because painting takes longer than counting. */
export function isDue(work) {
  const now = performance.now();
  if (work.painted && now - work.painted < REPAINT) return false;
  work.painted = now;
  return true;
}

/** Counts of one picture. */
export class Raster {
  constructor(width, height) {
    this.width = Math.max(1, Math.round(width));
    this.height = Math.max(1, Math.round(height));
    this.layers = [];
    this.image = new ImageData(this.width, this.height);
  }

  clear() {
    for (const layer of this.layers) layer?.fill(0);
  }

  layer(at) {
    return (this.layers[at] ??= new Float32Array(this.width * this.height));
  }

  /** Adds an anti-aliased line with this weight per step along its longer side (Wu 1991). */
  line(layer, x0, y0, x1, y1, weight) {
    const { width, height } = this;
    const dx = x1 - x0, dy = y1 - y0;
    if (Math.abs(dy) <= dx) {
      const slope = dy / dx;
      const from = Math.max(0, Math.ceil(x0)), to = Math.min(width - 1, Math.floor(x1));
      let y = y0 + slope * (from - x0);
      for (let x = from; x <= to; x++, y += slope) {
        const row = y | 0, share = y - row;
        const at = row * width + x;
        if (row >= 0 && row < height - 1) {
          layer[at] += weight * (1 - share);
          layer[at + width] += weight * share;
        }
      }
      return;
    }
    const slope = dx / dy;
    let top = y0, bottom = y1, x = x0;
    if (dy < 0) [top, bottom, x] = [y1, y0, x1];
    const from = Math.max(0, Math.ceil(top)), to = Math.min(height - 1, Math.floor(bottom));
    x += slope * (from - top);
    for (let y = from; y <= to; y++, x += slope) {
      const column = x | 0, share = x - column;
      const at = y * width + column;
      if (column >= 0 && column < width - 1) {
        layer[at] += weight * (1 - share);
        layer[at + 1] += weight * share;
      }
    }
  }

  /** Adds a disc with soft edges. */
  dot(layer, x, y, radius) {
    const { width, height } = this;
    const left = Math.max(0, Math.floor(x - radius)), right = Math.min(width - 1, Math.ceil(x + radius));
    const top = Math.max(0, Math.floor(y - radius)), bottom = Math.min(height - 1, Math.ceil(y + radius));
    for (let j = top; j <= bottom; j++) {
      for (let i = left; i <= right; i++) {
        const inside = radius + 0.5 - Math.hypot(i - x, j - y);
        if (inside > 0) layer[j * width + i] += Math.min(1, inside);
      }
    }
  }

  /**
   * Paints the counts: `palette` has one colour per layer, `sizes` the number of rows of each. The opacity grows with the
   * logarithm of the count up to `full`. Where classes meet, the one that is over-represented there gives most of the colour:
   * the weight of a class is (count / size^0.7)², between the count alone and the share of the class.
   */
  paint(context, palette, sizes, full, scale, most = 1) {
    const { image, layers } = this;
    const pixels = image.data;
    const known = [];
    layers.forEach((layer, at) => layer && palette[at] && known.push({ layer, colour: palette[at], share: 1 / Math.max(1, sizes[at] ?? 1) ** 0.7 }));
    const opacity = new Uint8Array(LEVELS + 1);
    for (let i = 0; i <= LEVELS; i++) opacity[i] = (255 * most * Math.log1p((full * i) / LEVELS)) / Math.log1p(full);
    const step = (LEVELS / full) * scale, n = known.length, all = this.width * this.height;
    const counts = known.map(({ layer }) => layer), shares = Float64Array.from(known, ({ share }) => share);
    const [reds, greens, blues] = [0, 1, 2].map((channel) => Float64Array.from(known, ({ colour }) => colour[channel]));
    for (let i = 0, to = 0; i < all; i++, to += 4) {
      let total = 0, sum = 0, red = 0, green = 0, blue = 0;
      for (let k = 0; k < n; k++) {
        const c = counts[k][i];
        if (c === 0) continue;
        const x = c * shares[k], w = x * x;
        total += c;
        sum += w;
        red += w * reds[k];
        green += w * greens[k];
        blue += w * blues[k];
      }
      if (total === 0) {
        pixels[to + 3] = 0;
        continue;
      }
      const w = 1 / sum, level = total * step;
      pixels[to] = red * w;
      pixels[to + 1] = green * w;
      pixels[to + 2] = blue * w;
      pixels[to + 3] = opacity[level < LEVELS ? level | 0 : LEVELS];
    }
    context.putImageData(image, 0, 0);
  }
}
