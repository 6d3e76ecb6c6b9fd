// The row of answers under a pair of clips: five steps.

import { make, renew } from "./dom.js";
import { names } from "./words.js";

/** The answer that belongs to step 1 to 5, as shown. */
export function level(step) {
  return { form: "level", value: 3 - step, levels: 5 };
}

/** Which step an earlier answer is, or null. */
function stepOf(answer) {
  switch (answer?.form) {
    case "equal": return 3;
    case "choice": return answer.value > 0 ? 2 : 4;
    case "level": return 3 - answer.value;
    default: return null;
  }
}

export class Strip {
  /** onAnswer(answer, event) when one is given; onHover(-1 | 0 | 1) when a side is pointed at. */
  constructor(root, { onAnswer, onHover = () => {} }) {
    this.root = root;
    this.onAnswer = onAnswer;
    this.onHover = onHover;
  }

  show(answer = null) {
    const [first, second] = names();
    const mark = stepOf(answer);
    const steps = [
      [`${first} much better`, "much better", first], [`${first} better`, "better", first], ["Equal", "equal", ""],
      [`${second} better`, "better", second], [`${second} much better`, "much better", second],
    ];
    const buttons = steps.map(([label, word, name], i) => {
      const side = Math.sign(2 - i);
      return make("button.step", {
        type: "button", "aria-label": label, "aria-pressed": mark === null ? null : mark === i + 1,
        "data-step": i + 1, "data-key": i + 1, "data-side": side, "aria-keyshortcuts": i + 1,
        onclick: (event) => this.onAnswer(level(i + 1), event),
        onpointerenter: () => this.onHover(side), onpointerleave: () => this.onHover(0),
      },
      make("span.step-side", {}, name), make("span.step-word", {}, word), make("kbd", { "aria-hidden": "true" }, i + 1));
    });
    renew(this.root, make("div.steps", {}, buttons));
  }

  /** Shows what was chosen while it is being sent. */
  mark(answer) {
    const step = stepOf(answer);
    for (const button of this.root.querySelectorAll(".step")) {
      button.classList.toggle("chosen", Number(button.dataset.step) === step);
    }
  }

  set busy(busy) {
    this.root.classList.toggle("busy", busy);
  }
}
