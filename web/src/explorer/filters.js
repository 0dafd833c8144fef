// Filters as a form: the way to select without a pointer, and to type exact numbers.

import { button, element } from "./dom.js";
import { figure, named, readable } from "./data.js";

/** Levels up to which each one has a box. */
const BOXES = 40;

export class Filters {
  constructor(parent, explorer) {
    this.explorer = explorer;
    this.grid = element("div", { class: "x-filters" });
    this.list = element("div", { class: "x-columns" });
    this.root = element(
      "details", { class: "x-form" }, element("summary", {}, "Filters and axes"),
      element("h3", {}, "Filters"), this.grid, element("h3", {}, "Axes"), this.list,
    );
    this.root.addEventListener("toggle", () => this.fill());
    parent.append(this.root);
  }

  /** Shows the present filters and axes. */
  fill() {
    const { data, axes, offered } = this.explorer;
    if (!this.root.open || !data.index) return;
    const inside = this.grid.contains(document.activeElement) || this.list.contains(document.activeElement);
    const key = `${axes.map((column) => column.at)}/${offered.map((column) => `${column.at}:${column.levels.length}`)}`;
    if (key !== this.key_ || !inside) {
      this.key_ = key;
      this.grid.replaceChildren(...axes.map((column) => this.filter(column)));
      this.list.replaceChildren(...offered.map((column) => {
        const box = element("input", {
          type: "checkbox", checked: axes.includes(column), disabled: axes.length <= 2 && axes.includes(column),
          onchange: () => this.explorer.setAxes(box.checked ? [...this.explorer.axes, column] : this.explorer.axes.filter((one) => one !== column)),
        });
        return element("label", {}, box, ` ${named(column)}`);
      }));
    }
  }

  filter(column) {
    const { data, selection } = this.explorer;
    const filter = selection.filters.get(column);
    if (column.kind === "category") {
      if (column.levels.length > BOXES) return element("fieldset", {}, element("legend", {}, named(column)), element("p", {}, "Too many words for a list."));
      const boxes = column.levels.map((level, at) => [at, element("input", { type: "checkbox", checked: !filter || filter.levels?.has(at) }), level]);
      const set = () => {
        const kept = boxes.filter(([, box]) => box.checked).map(([at]) => at);
        this.explorer.setFilter(column, kept.length === boxes.length ? null : { levels: new Set(kept) });
      };
      boxes.forEach(([, box]) => box.addEventListener("change", set));
      return element("fieldset", {}, element("legend", {}, named(column)), ...boxes.map(([, box, level]) => element("label", {}, box, ` ${readable(level)}`)));
    }
    const [low, high] = data.range(column);
    const input = (label, value, otherwise) => element("input", { type: "number", step: "any", "aria-label": `${column.label}: ${label}`, value: value === undefined || value === otherwise ? "" : Number(value.toPrecision(6)), placeholder: figure(otherwise) });
    const from = input("at least", filter?.low, low), to = input("at most", filter?.high, high);
    const set = () => {
      const [a, b] = [from.value === "" ? -Infinity : Number(from.value), to.value === "" ? Infinity : Number(to.value)];
      this.explorer.setFilter(column, from.value === "" && to.value === "" ? null : { low: a, high: b });
    };
    from.addEventListener("change", set);
    to.addEventListener("change", set);
    return element("fieldset", {}, element("legend", {}, named(column)), from, " to ", to, filter ? button("Clear", () => this.explorer.setFilter(column, null)) : null);
  }
}
