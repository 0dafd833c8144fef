// The viewer of the script before this one (web/src/replays.js), so that three.js is in the page once.

export const Viewer = window.robogateViewer;
