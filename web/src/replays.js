// The viewer of recorded episodes for all pages: it plays the recordings of this page, if it has some, and other scripts use it.

import { Viewer } from "./viewer.js";

window.robogateViewer = Viewer;

function start() {
  const data = document.getElementById("reel");
  const parent = document.querySelector("[data-viewer]");
  if (!data || !parent) return;
  const viewer = new Viewer(parent, JSON.parse(data.textContent));
  const choices = [...document.querySelectorAll("button[data-first]")];
  const open = (choice) => {
    choices.forEach((other) => other.setAttribute("aria-pressed", String(other === choice)));
    const second = choice.dataset.second;
    return viewer.open(Number(choice.dataset.first), second === undefined ? null : Number(second));
  };
  choices.forEach((choice) => {
    choice.disabled = false;
    choice.addEventListener("click", () => open(choice));
  });
  // Other parts of the page open recordings by their place in the reel.
  document.addEventListener("open-episode", (event) => {
    choices.forEach((other) => other.setAttribute("aria-pressed", "false"));
    void viewer.open(event.detail, null);
    viewer.root.scrollIntoView({ block: "nearest" });
    viewer.play.focus();
  });
  if (choices[0]) open(choices[0]);
}

start();
