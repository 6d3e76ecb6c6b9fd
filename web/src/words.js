// Plain words for what the program knows.

const stacked = matchMedia("(max-width: 640px) and (orientation: portrait)");

/** What the two clips are called, as they lie on this screen. */
export function names() {
  return stacked.matches ? ["Top", "Bottom"] : ["Left", "Right"];
}

export function whenStacked(each) {
  stacked.addEventListener("change", each);
}

/** An answer as shown, in words: "left much better". */
export function said(answer) {
  if (!answer) return "no answer";
  const side = names()[answer.value > 0 ? 0 : 1];
  switch (answer.form) {
    case "equal": return "equal";
    case "unsure": return "cannot tell";
    case "choice": return `${side} better`;
    case "level":
      if (!answer.value) return "equal";
      return `${side} ${Math.abs(answer.value) > 1 ? "much better" : "better"}`;
    case "number": return `${side} better by ${Math.abs(answer.value).toPrecision(3)}`;
    default: return typeof answer.value === "number" ? `${side} better` : answer.form;
  }
}

/** What comes of an answer that is changed, or that comes late. */
export function taken({ state, trained }) {
  if (state === "finished") return "It has finished learning: this is kept, and changes nothing.";
  if (state === "finishing") return "It is finishing: this is kept, and may come too late to change anything.";
  return trained ? "It learns from this now." : "It learns from this when it goes on.";
}

/** Where what it does now would be shown. */
export const NOTHING = "It has tried nothing yet by what you taught it.";

/** "1 answer", "2 answers". */
export function many(n, what) {
  return `${n} ${what}${n === 1 ? "" : "s"}`;
}

/** How many answers it foresaw, of ten. */
export function foreseen({ sure, answers, people }) {
  if (sure === null || sure === undefined) {
    if (people === false) return "";
    return answers ? "Too early to say how well it understands you" : "It knows nothing about your wishes yet";
  }
  return `It foresees ${Math.round(10 * sure)} of 10 of ${people === false ? "the judge's" : "your"} answers`;
}

/** Whether it is worth going on. */
export function helping({ worth, enough, state, people }) {
  if (people === false || state === "stopped") return "";
  if (state === "finished") return "It needs no more answers";
  if (state === "finishing") return "It asks no more";
  if (enough) return "More answers hardly help: you may finish";
  if (worth === null || worth === undefined || worth > 0.05) return "More answers help a lot";
  return worth > 0.01 ? "More answers help a little" : "More answers hardly help";
}

/** What to do about a run whose trainer is gone. */
export function stopped(run, people = true) {
  return `Go on with "hiprl resume ${run}" in a terminal${people ? "; your answers are kept" : ""}.`;
}

/** What it does while there is nothing to ask: a title and a sentence. */
export function meanwhile({ state, answers }, run) {
  switch (state) {
    case "stopped":
      return ["It is not running", stopped(run)];
    case "warming up":
      return ["Trying out movements", "It moves about at random first, so that there is something to compare."];
    case "learning":
      return ["Practising what you taught it…", "The next pair comes as soon as it has tried something new."];
    case "finishing":
      return ["Practising for the last time…", "It has all your answers. Once it gets no better any more, it is finished."];
    case "finished":
      return ["Finished", "It has learned from you. This is what it does now."];
    default:
      return answers
        ? ["The next pair is on its way…", "It is looking for what is most worth asking."]
        : ["Getting ready…", "The first pair comes in a moment."];
  }
}

/** A number, short. */
export function short(x) {
  if (x === null || x === undefined || !Number.isFinite(x)) return "–";
  const size = Math.abs(x);
  return size >= 100 ? Math.round(x).toLocaleString("en") : size >= 1 ? x.toFixed(1) : x === 0 ? "0" : x.toPrecision(2);
}
