// The player comes in a script of its own, so that the page is there before three.js is.

let loading = null;

/** Makes a player in an element; loads the script on first use. */
export async function film(element, options) {
  loading ??= import("/static/player.js");
  await loading;
  return window.hiprlPlayer(element, options);
}

export function early() {
  loading ??= import("/static/player.js");
}
