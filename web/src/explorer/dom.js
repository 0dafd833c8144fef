// Small parts of the page. Text from files enters through text nodes alone.

import { svg } from "../chart.js";

export { svg };

export function element(name, attributes = {}, ...children) {
  const node = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    if (key.startsWith("on")) node.addEventListener(key.slice(2), value);
    else if (value !== false && value !== undefined && value !== null) node.setAttribute(key, value === true ? "" : value);
  }
  node.append(...children.flat().filter((child) => child !== undefined && child !== null));
  return node;
}

/** A list of choices with a label. `options` are pairs of value and text. */
export function choice(label, options, value, act) {
  const select = element("select", { onchange: () => act(select.value) });
  const fill = (all, chosen) => {
    select.replaceChildren(...all.map(([key, text]) => new Option(text, key, false, String(key) === String(chosen))));
  };
  fill(options, value);
  const root = element("label", { class: "x-choice" }, element("span", {}, label), select);
  return { root, select, fill };
}

export function button(text, act, attributes = {}) {
  return element("button", { type: "button", onclick: act, ...attributes }, text);
}

/** A canvas over the whole of its parent, in device pixels. */
export function layer(parent) {
  const canvas = element("canvas", { "aria-hidden": "true" });
  parent.append(canvas);
  const context = canvas.getContext("2d");
  return {
    canvas,
    context,
    resize(width, height, ratio) {
      canvas.width = Math.max(1, Math.round(width * ratio));
      canvas.height = Math.max(1, Math.round(height * ratio));
    },
  };
}
