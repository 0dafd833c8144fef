// The rows of the selection. Only the visible ones are in the page.

import { element } from "./dom.js";
import { css } from "./colours.js";
import { count, named, shown } from "./data.js";

const ROW = 30, MOST = 20000;

export class Table {
  constructor(parent, explorer) {
    this.explorer = explorer;
    this.rows = new Uint32Array(0);
    this.active = 0;
    this.order = { column: null, down: false };
    this.head = element("div", { class: "x-tr x-th", role: "row" });
    this.body = element("div", { class: "x-tbody", role: "rowgroup" });
    this.scroll = element("div", { class: "x-scroll", tabindex: 0, role: "grid", "aria-label": "Episodes of the selection. Arrow keys move, Enter plays." }, element("div", { role: "rowgroup", class: "x-thead" }, this.head), this.body);
    this.note = element("p", { class: "x-reading", "aria-live": "polite" });
    parent.append(this.scroll, this.note);
    this.scroll.addEventListener("scroll", () => this.explorer.wake((this.stale = true)));
    this.scroll.addEventListener("keydown", (event) => this.key(event));
    new ResizeObserver(() => this.explorer.wake((this.stale = true))).observe(this.scroll);
  }

  /** Takes the selection anew, in the next frame. */
  restart() {
    this.dirty = true;
    this.explorer.wake();
  }

  step(deadline) {
    // The list is for reading: it follows when the plots are drawn.
    if (this.dirty && performance.now() > deadline) return false;
    if (this.dirty) this.collect();
    if (this.dirty || this.stale) this.draw();
    this.dirty = this.stale = false;
    return true;
  }

  collect() {
    const { data, selection } = this.explorer;
    const { column, down } = this.order;
    const rows = column && selection.kept > MOST ? this.ends(column, down) : this.first();
    if (column) {
      const { values } = column, sign = down ? -1 : 1;
      // Missing values are last in both directions.
      rows.sort((a, b) => {
        const [x, y] = [values[a], values[b]];
        if (x !== x || y !== y) return (x !== x) - (y !== y) || a - b;
        return sign * (x - y) || a - b;
      });
    }
    this.rows = rows.length > MOST ? rows.subarray(0, MOST) : rows;
    this.active = Math.min(this.active, Math.max(0, this.rows.length - 1));
    const more = selection.kept > MOST ? ` The list shows ${count(MOST)} of them.` : "";
    this.note.textContent = `${count(selection.kept)} episodes.${more}`;
  }

  /** The first selected rows. */
  first() {
    const { data, selection } = this.explorer;
    const rows = new Uint32Array(Math.min(selection.kept, MOST));
    let n = 0;
    for (let row = 0; row < data.rows && n < rows.length; row++) if (selection.has(row)) rows[n++] = row;
    return rows;
  }

  /** The selected rows with the smallest or the largest values, at least as many as the list shows. Of very many equal values, some. */
  ends(column, down) {
    const { data, selection } = this.explorer;
    const { rows, starts, bins } = data.order(column);
    const found = [], most = column.kind === "number" ? 4 * MOST : MOST;
    for (let i = 0; i < bins && found.length < MOST; i++) {
      const bin = down ? bins - 1 - i : i;
      for (let at = starts[bin]; at < starts[bin + 1] && found.length < most; at++) if (selection.has(rows[at])) found.push(rows[at]);
    }
    for (let row = 0; row < data.rows && found.length < MOST; row++) if (column.values[row] !== column.values[row] && selection.has(row)) found.push(row);
    return Uint32Array.from(found);
  }

  get columns() {
    const { data, axes, prediction } = this.explorer;
    const first = data.runs.length > 1 ? [data.run, data.index, data.outcome] : [data.index, data.outcome];
    return [...new Set([...first, ...axes, ...(prediction ? [prediction] : [])])];
  }

  draw() {
    const { data, colours, opened } = this.explorer;
    if (!data.index) return;
    const columns = this.columns;
    const grid = `44px ${columns.map((column) => (column.kind === "category" ? "minmax(112px, 1fr)" : "minmax(88px, 1fr)")).join(" ")}`;
    const width = 44 + columns.length * 112;
    this.scroll.setAttribute("aria-rowcount", this.rows.length + 1);
    this.scroll.setAttribute("aria-colcount", columns.length + 1);
    this.head.style.gridTemplateColumns = grid;
    this.head.style.minWidth = this.body.style.minWidth = `${width}px`;
    const key = columns.map((column) => `${column.name}${this.order.column === column ? this.order.down : ""}`).join();
    if (key !== this.key_) {
      this.key_ = key;
      this.head.replaceChildren(element("span", { role: "columnheader" }, element("span", { class: "x-hidden" }, "Play")), ...columns.map((column) => {
        const own = this.order.column === column;
        const sort = element("button", { type: "button", tabindex: -1, title: `Sort by ${named(column)}` }, `${named(column)}${own ? (this.order.down ? " ↓" : " ↑") : ""}`);
        sort.addEventListener("click", () => {
          this.order = { column, down: own ? !this.order.down : false };
          this.restart();
        });
        return element("span", { role: "columnheader", class: column.kind === "category" ? false : "num", "aria-sort": own ? (this.order.down ? "descending" : "ascending") : "none" }, sort);
      }));
    }
    const visible = Math.ceil(this.scroll.clientHeight / ROW) + 2;
    const from = Math.max(0, Math.floor(this.scroll.scrollTop / ROW) - 1), to = Math.min(this.rows.length, from + visible + 1);
    this.body.style.height = `${this.rows.length * ROW}px`;
    const lines = [];
    for (let at = from; at < to; at++) {
      const row = this.rows[at];
      const run = data.run.values[row], index = data.index.values[row];
      const has = this.explorer.canPlay(run, index);
      const line = element("div", { class: "x-tr", role: "row", id: `x-row-${at}`, "aria-rowindex": at + 2, "aria-selected": String(row === opened) });
      line.style.transform = `translateY(${at * ROW}px)`;
      line.style.gridTemplateColumns = grid;
      if (at === this.active) line.classList.add("active");
      const swatch = element("i", { class: "x-swatch" });
      swatch.style.background = css(colours.palette[colours.classes[row]] ?? [128, 128, 128]);
      line.append(element("span", { role: "gridcell" }, swatch, has ? "▶" : ""));
      for (const column of columns) line.append(element("span", { role: "gridcell", class: column.kind === "category" ? false : "num" }, shown(column, column.values[row])));
      line.addEventListener("click", () => {
        this.active = at;
        this.explorer.open(row);
      });
      lines.push(line);
    }
    this.body.replaceChildren(...lines);
    if (this.rows.length) this.scroll.setAttribute("aria-activedescendant", `x-row-${this.active}`);
    else this.scroll.removeAttribute("aria-activedescendant");
    if (this.active < from || this.active >= to) this.scroll.removeAttribute("aria-activedescendant");
  }

  key(event) {
    const page = Math.max(1, Math.floor(this.scroll.clientHeight / ROW) - 2);
    const to = { ArrowDown: this.active + 1, ArrowUp: this.active - 1, PageDown: this.active + page, PageUp: this.active - page, Home: 0, End: this.rows.length - 1 }[event.key];
    if (event.key === "Enter" && this.rows.length && event.target === this.scroll) {
      this.explorer.open(this.rows[this.active]);
      return;
    }
    if (to === undefined) return;
    event.preventDefault();
    this.active = Math.min(this.rows.length - 1, Math.max(0, to));
    const top = this.active * ROW, { scrollTop, clientHeight } = this.scroll;
    if (top < scrollTop) this.scroll.scrollTop = top;
    else if (top + 2 * ROW > scrollTop + clientHeight) this.scroll.scrollTop = top + 2 * ROW - clientHeight + 4;
    this.stale = true;
    this.explorer.wake();
  }
}
