// What is selected: counts, the success rate with its interval, and the legend.

import { button, element } from "./dom.js";
import { count, named, percent, readable, shown } from "./data.js";
import { css } from "./colours.js";
import { clopperPearson, wilson } from "./stats.js";

/** Episodes up to which the exact interval is shown, whose coverage never is below 95 %. */
const FEW = 40;

export class Summary {
  constructor(parent, explorer) {
    this.explorer = explorer;
    this.rates = element("div", { class: "x-rates" });
    this.caution = element("p", { class: "x-caution", hidden: true });
    this.chips = element("div", { class: "x-chips" });
    this.legend = element("div", { class: "x-legend", role: "group" });
    this.live = element("p", { class: "x-hidden", "aria-live": "polite" });
    parent.append(element("div", { class: "x-summary" }, element("div", {}, this.rates, this.caution), element("div", {}, this.legend, this.chips)), this.live);
  }

  step() {
    if (this.stale) this.draw();
    this.stale = false;
    return true;
  }

  restart() {
    this.stale = true;
    this.explorer.wake();
  }

  draw() {
    const { data, selection } = this.explorer;
    if (!selection.counts) return;
    const chosen = !selection.isEmpty;
    // Without a selection, the server has counted all episodes, also those that are not on the page.
    const runs = data.isSample && !chosen ? data.runs.map((run) => run.counts) : selection.runs;
    const several = data.runs.length > 1;
    this.rates.replaceChildren(...runs.map((of, at) => this.rate(of, several ? data.runs[at].name : null, chosen)));
    this.caution.textContent = chosen
      ? "You chose this selection after you saw its outcomes, so its interval is too narrow, and a difference from the rest is not a test. Run new episodes in this region to test it."
      : "";
    this.caution.hidden = !chosen;
    this.drawLegend();
    this.drawChips();
    clearTimeout(this.timer);
    this.timer = setTimeout(() => { this.live.textContent = runs.map((of, at) => this.sentence(of, several ? data.runs[at].name : "")).join(" "); }, 700);
  }

  sentence(of, name) {
    if (of.n === 0) return `${name} no valid episode is selected.`;
    const [low, high] = (of.n <= FEW ? clopperPearson : wilson)(of.k, of.n);
    return `${name} ${of.k} of ${of.n} selected episodes succeeded: ${percent(of.k / of.n)}, 95 % interval ${percent(low)} to ${percent(high)}.`;
  }

  rate(of, name, chosen) {
    const [low, high] = (of.n <= FEW ? clopperPearson : wilson)(of.k, of.n);
    const bar = element("div", { class: "x-scale", "aria-hidden": "true" }, element("i", {}), element("b", {}));
    bar.children[0].style.left = `${100 * low}%`;
    bar.children[0].style.width = `${100 * (high - low)}%`;
    bar.children[1].style.left = of.n ? `${(100 * of.k) / of.n}%` : "-10px";
    const more = [];
    if (chosen && this.explorer.data.isSample) more.push("Counted in the random sample on this page.");
    if (of.focused > 0) more.push(`${count(of.focused)} that the boundary or active stage chose do not count: most were sampled where failures are likely.`);
    if (of.invalid > 0) more.push(`${count(of.invalid)} invalid.`);
    return element(
      "div", { class: "x-rate" },
      name === null ? null : element("p", { class: "x-run" }, name),
      element("p", { class: "x-big" }, of.n ? percent(of.k / of.n) : "–"),
      bar,
      element("p", { class: "x-what" }, of.n ? `${count(of.k)} of ${count(of.n)} ${chosen ? "selected " : ""}episodes succeeded, 95 % interval ${percent(low)} to ${percent(high)} (${of.n <= FEW ? "Clopper-Pearson" : "Wilson"})` : "No valid episode is selected."),
      more.length ? element("p", { class: "x-more" }, more.join(" ")) : null,
    );
  }

  /** One button per class, which keeps it alone or gives it up. */
  drawLegend() {
    const { data, selection, colours } = this.explorer;
    const { column, palette, labels, sets } = colours;
    const counts = selection.kinds;
    this.legend.setAttribute("aria-label", `Colours: ${named(column)}. Press one to select it.`);
    const filter = selection.filters.get(column);
    const kept = Math.max(1, selection.kept);
    this.legend.replaceChildren(...palette.map((colour, at) => {
      if (sets ? sets[at].length === 0 : at === palette.length - 1 && counts[at] === 0) return null;
      const range = !sets && at < palette.length - 1 ? [at, at + 1].map((i) => data.value(column, i / (palette.length - 1))) : null;
      const near = (value, other) => Math.abs(data.place(column, value) - data.place(column, other)) < 1e-4;
      const pressed = sets
        ? filter?.levels !== undefined && sets[at].length === filter.levels.size && sets[at].every((level) => filter.levels.has(level))
        : range !== null && filter !== undefined && !filter.levels && near(filter.low, range[0]) && near(filter.high, range[1]);
      const swatch = element("i", { class: "x-swatch" }), bar = element("span", { class: "x-share", "aria-hidden": "true" }, element("i", {}));
      swatch.style.background = bar.firstChild.style.background = css(colour);
      bar.firstChild.style.width = `${(100 * counts[at]) / kept}%`;
      const key = button("", () => {
        if (pressed) this.explorer.setFilter(column, null);
        else if (sets) this.explorer.setFilter(column, { levels: new Set(sets[at]) });
        else if (range) this.explorer.setFilter(column, { low: range[0], high: range[1] });
      }, { class: "x-key", "aria-pressed": String(pressed) });
      key.append(swatch, element("span", { class: "x-key-name" }, labels[at]), bar, element("span", { class: "num" }, count(counts[at])));
      return key;
    }).filter(Boolean));
  }

  /** The filters in words, each with a button that removes it. */
  drawChips() {
    const { selection } = this.explorer;
    const chips = [];
    for (const [column, filter] of selection.filters) {
      const unit = column.unit ? ` ${column.unit}` : "";
      const bound = (value) => (Number.isFinite(value) ? `${shown(column, value)}${unit}` : null);
      const [low, high] = [bound(filter.low), bound(filter.high)];
      const words = filter.levels
        ? [...filter.levels].slice(0, 4).map((level) => readable(column.levels[level])).join(", ") + (filter.levels.size > 4 ? ", …" : "") || "nothing"
        : low && high ? `${low} to ${high}` : low ? `at least ${low}` : high ? `at most ${high}` : "any";
      chips.push(button(`${column.label}: ${words} ×`, () => this.explorer.setFilter(column, null), { "aria-label": `Remove the filter ${column.label}: ${words}` }));
    }
    if (selection.lasso) chips.push(button(`${selection.lasso.text} ×`, () => this.explorer.setLasso(null), { "aria-label": `Remove the ${selection.lasso.text}` }));
    if (chips.length) chips.push(button("Clear all", () => this.explorer.clear(), { class: "x-clear" }));
    this.chips.replaceChildren(...chips);
  }
}
