/** The panel of the estimated error: how large it is, how it became so, and how long the rest takes. */

import { Chart } from "./chart.js";
import { History } from "./history.js";
import { errorInWords, rangeInWords, shareInWords, timeInWords } from "./units.js";

/** Shows the history of the view that is at rest. */
export class ErrorPanel {
  #root;
  #target;
  #chart;
  #history = new History();

  /**
   * @param {HTMLElement} root holds a `.value`, a `.note`, an `svg` and a `.legend`
   * @param {number} target relative error at which light counts as final
   */
  constructor(root, target) {
    this.#root = root;
    this.#target = target;
    this.#chart = new Chart(root.querySelector("svg"));
    this.#write();
  }

  /**
   * Begin anew at every change of a view that changes its light, which exposure, marks and comparing do not.
   * @param {import("./view.js").ViewModel} view
   */
  follow(view) {
    view.watch(lightOf, () => {
      this.#history.begin();
      this.#write();
    });
  }

  /**
   * Add a frame.
   * @param {import("./api.js").Facts} facts
   * @param {boolean} draft whether the view is still moving; such frames are no part of the history
   */
  show(facts, draft) {
    if (draft) return;
    this.#history.add(facts);
    this.#write(facts.timeLeft);
  }

  #write(timeLeft = null) {
    const { moments, latest } = this.#history;
    this.#find(".value").textContent = latest ? errorInWords(latest.error) : "";
    this.#find(".note").textContent = latest ? inWords(latest, timeLeft) : "Waiting for the view to rest.";
    this.#find("svg").setAttribute("aria-label", courseInWords(moments, this.#target));
    for (const item of this.#root.querySelectorAll(".legend b")) item.textContent = shareOf(item.parentNode.className, latest);
    this.#chart.show(moments, this.#target);
  }

  #find(selector) {
    return this.#root.querySelector(selector);
  }
}

function lightOf({ exposure, overlay, compare, ...rest }) {
  return rest;
}

function inWords({ seconds, provisional, error }, timeLeft) {
  const time = `after ${timeInWords(seconds)}`;
  if (!provisional) return error > 0 ? `final ${time}` : `final ${time} · nothing to estimate`;
  return timeLeft ? `${time} · ${rangeInWords(timeLeft)}` : time;
}

function courseInWords(moments, target) {
  if (!moments.length) return "Estimated error and coverage over time: nothing yet";
  const [first, last] = [moments[0], moments.at(-1)];
  const aim = target > 0 ? `, target ${errorInWords(target)}` : "";
  const error = `Estimated error from ${errorInWords(first.error)} to ${errorInWords(last.error)}${aim}`;
  const shares = `surface that is final from ${shareInWords(first.coverage.final)} to ${shareInWords(last.coverage.final)}`;
  return `${error}; ${shares}; over ${timeInWords(last.seconds)}`;
}

/** What is not final is rounded up, as the server does. */
function shareOf(state, moment) {
  if (!moment) return "";
  const share = moment.coverage[state];
  return state === "final" ? shareInWords(share) : `${Math.ceil(100 * share - 1e-9)} %`;
}
