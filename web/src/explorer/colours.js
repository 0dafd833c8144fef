// The colour of each row: a class of a few, with a palette that colour-blind people can tell apart.

import { figure, percent, readable } from "./data.js";

/** Colours of words: Okabe and Ito (2008), with the first for success. */
const WORDS = {
  light: ["#1f6fb2", "#d55e00", "#e0a000", "#b0559b", "#128a72", "#6b3d12", "#4a4a9c", "#8fbfe6", "#7a7a00", "#c0392b"],
  dark: ["#5ba3e0", "#f07f35", "#f2c14e", "#dd93cb", "#4cc3a6", "#c99a6b", "#9a96ec", "#b4d8f5", "#d6c545", "#f07c6c"],
};
const OTHER = { light: "#8b9198", dark: "#7d838b" };
/** A scale from small to large, with a lightness that changes evenly. */
const SCALE = { light: ["#e9b949", "#d9744f", "#a8417f", "#3d2c86"], dark: ["#6457c9", "#b5579f", "#ec8265", "#f6d873"] };
/** The chance of success: from failure to success. */
const CHANCE = {
  light: ["#9a3f0c", "#c2682c", "#dd9a6b", "#d9d2c8", "#9fc0de", "#5b92c6", "#1f5a92"],
  dark: ["#f0904f", "#c56f34", "#8d5a38", "#55565a", "#3c6b94", "#5b9bd0", "#8cc2f0"],
};
const STEPS = 10;

export const isDark = () => matchMedia("(prefers-color-scheme: dark)").matches;
const theme = () => (isDark() ? "dark" : "light");

function rgb(hex) {
  return [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16));
}

function mixed(stops, share) {
  const at = Math.min(stops.length - 1.000001, Math.max(0, share * (stops.length - 1)));
  const [a, b] = [rgb(stops[Math.floor(at)]), rgb(stops[Math.floor(at) + 1])];
  return a.map((x, i) => Math.round(x + (at % 1) * (b[i] - x)));
}

/** The colour of a chance of success. */
export const ofChance = (p) => mixed(CHANCE[theme()], p);
export const css = ([r, g, b]) => `rgb(${r} ${g} ${b})`;
/** The colour of rows that are not selected. */
export const faint = () => (isDark() ? [96, 100, 106] : [176, 172, 164]);

/** Classes of all rows by a column. */
export function colouring(data, column) {
  const classes = new Uint8Array(data.rows);
  const { values } = column;
  if (column.kind === "category") {
    const words = WORDS[theme()];
    // The most common levels get colours of their own; success is always first.
    const counts = new Array(column.levels.length).fill(0);
    for (let i = 0; i < data.rows; i++) if (values[i] === values[i]) counts[values[i]] += 1;
    const levels = counts.map((n, i) => i).filter((i) => counts[i] > 0);
    const isOutcome = column.role === "outcome";
    levels.sort((a, b) => (isOutcome && (a === 0 || b === 0) ? a - b : counts[b] - counts[a] || a - b));
    const invalid = isOutcome ? column.levels.indexOf("invalid") : -1;
    const own = levels.filter((level) => level !== invalid).slice(0, words.length);
    if (isOutcome && own[0] !== 0) own.unshift(0);
    const other = own.length;
    const place = new Uint8Array(column.levels.length + 1).fill(other);
    own.forEach((level, at) => { place[level] = at; });
    for (let i = 0; i < data.rows; i++) classes[i] = values[i] === values[i] ? place[values[i]] : other;
    const rest = levels.filter((level) => !own.includes(level));
    const palette = own.map((_, at) => rgb(words[at % words.length]));
    const labels = own.map((level) => readable(column.levels[level]));
    palette.push(rgb(OTHER[theme()]));
    labels.push(rest.length === 1 ? readable(column.levels[rest[0]]) : rest.length > 1 ? "other" : "no value");
    const sets = own.map((level) => [level]);
    sets.push(rest);
    return { column, classes, palette, labels, sets };
  }
  const stops = column.percent ? CHANCE : SCALE;
  // Quantiles would hide outliers less, but a legend with even steps is read at a glance.
  for (let i = 0; i < data.rows; i++) {
    const share = values[i] === values[i] ? data.place(column, values[i]) : -1;
    classes[i] = share < 0 && values[i] !== values[i] ? STEPS : Math.min(STEPS - 1, Math.max(0, Math.floor(share * STEPS)));
  }
  const palette = Array.from({ length: STEPS }, (_, i) => mixed(stops[theme()], i / (STEPS - 1)));
  palette.push(rgb(OTHER[theme()]));
  const edge = (i) => (column.percent ? percent(data.value(column, i / STEPS)) : figure(data.value(column, i / STEPS)));
  const labels = Array.from({ length: STEPS }, (_, i) => `${edge(i)} to ${edge(i + 1)}`);
  labels.push("no value");
  return { column, classes, palette, labels, sets: null };
}

