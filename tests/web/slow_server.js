/**
 * A server that is three seconds away, in place of the one behind the page's stream, and what looks for lies meanwhile.
 * Each picture is of one colour, which is its number; so whatever lies on the stage says what it was drawn for. What the
 * visitor's card draws over it is known by the controls at the time; the card is a processor, which the address asks for.
 */
(() => {
  const DELAY_MS = 3000;
  const LAST = 3; // the picture of a view that is final
  const [OLD_MS, OLD_FRAMES] = [700, 40]; // after which an old picture is dimmed: 300, a fade, and a slow machine
  const DIM = 0.8; // opacity below which a picture is
  const CLAIM = /%|percent| left|Done|Refining/;
  const PREDICTED = / · drawn here, about [^()]* error \(predicted\)$/;
  const WAITS = ["Moving", "Updating"];
  const UNLIT = 4; // of every so many views, the first picture of one is not lit all over
  const NO_PICTURE = ["compare", "rulers-choice", "isovalue-number", "exposure"]; // of the last one its words count

  // A processor is slow, and left to the server: the address asks for it, also that of another scene.
  const query = new URLSearchParams(location.search);
  query.set("draw", "card");
  if (location.protocol.startsWith("http")) history.replaceState(null, "", `?${query}`);

  const $ = (selector) => document.querySelector(selector);
  const pictures = new Map();
  const report = { changes: 0, looks: 0, drawn: 0, lies: [], ...JSON.parse(sessionStorage.getItem("report")) };
  window.report = report;

  let size = ""; // of the stage, as it was last painted, or at the first view, which may be sent before

  /** The stage's size, whether it is painted or not. */
  function sizeNow() {
    const { width, height } = $("#stage").getBoundingClientRect();
    return `${width}×${height}`;
  }

  /** All controls that a picture depends on, as a text; what makes the same picture has the same text. */
  function controls() {
    const fields = [...document.querySelectorAll("#scene, #controls :is(input, select)")].filter(({ id }) => !NO_PICTURE.includes(id));
    const values = Object.fromEntries(fields.map(({ id, type, value, checked }) => [id, type === "checkbox" ? checked : value]));
    if (values.background === "page") values.background = "light"; // as this browser is
    if ($("#uncut").disabled) values.opened = "nothing is cut";
    values.exposure = $("output[for=exposure]").value;
    return Object.entries({ ...values, size }).map(([name, value]) => `${name}=${value}`).join(" | ");
  }

  /** What differs between two such texts. */
  function differing(one, other) {
    const [a, b] = [one, other].map((text) => text.split(" | "));
    return a.flatMap((each, k) => (each === b[k] ? [] : [`${each} → ${b[k]}`])).join(", ");
  }

  /** What the picture of this number says about itself; no two that follow each other say the same. */
  function factsOf(number, step) {
    const [final, error] = [(number % 7) / 10, ((number * 7) % 89 + 10) / 1000];
    const left = step === LAST ? null : { low: 5, likely: 10 + (number % 80), high: 100 };
    const unlit = step === 1 && number % UNLIT === 0 ? 0.3 * (1 - final) : 0;
    const coverage = step === LAST ? { final: 1, converging: 0, provisional: 0 } : { final, converging: 1 - final - unlit, provisional: unlit };
    const pixels = Object.fromEntries(Object.entries({ surface: 1, ...coverage }).map(([name, share]) => [name, Math.round(1000 * share)]));
    const measured = { error, noise: error / 2, interval: [0.8 * error, 1.2 * error], controls: 9, p99: null, p99_interval: null };
    return { provisional: step < LAST, coverage, pixels, ...measured, chunks: { needed: 9, final: 1 }, time_left: left, overdue: false };
  }

  async function painted(number) {
    const canvas = new OffscreenCanvas(8, 8), paint = canvas.getContext("2d");
    paint.fillStyle = `#${number.toString(16).padStart(6, "0")}`;
    paint.fillRect(0, 0, 8, 8);
    return canvas.convertToBlob();
  }

  /** A stream of one scene: the newest view wins, and each picture takes its time. */
  class SlowStream {
    readyState = 0;
    #newest = null;
    #drawn = null;
    #timer = 0;
    constructor() {
      setTimeout(() => {
        this.readyState = 1;
        this.onopen();
      }, 20);
    }

    send(text) {
      const message = JSON.parse(text);
      if ("shown" in message) return;
      size ||= sizeNow();
      const now = controls(), before = this.#newest;
      const isSame = before && !before.moving && !message.moving && before.controls === now;
      this.#newest = { ...message, controls: now, step: isSame ? Math.min(before.step, LAST - 1) : 0 }; // light is not forgotten
      leave(this.#newest.controls); // at the earliest now, also where no look falls between two changes
      if (!(this.#drawn?.moving && message.moving)) this.#draw();
    }

    #draw() {
      clearTimeout(this.#timer);
      const view = this.#drawn = this.#newest;
      this.#timer = setTimeout(() => this.#answer(view), DELAY_MS);
    }

    async #answer(view) {
      const number = pictures.size + 1, step = ++view.step;
      const facts = factsOf(number, step);
      pictures.set(number, { ...view, facts, draft: view.moving });
      this.onmessage({ data: JSON.stringify({ id: view.id, draft: view.moving, final: !facts.provisional, media_type: "image/png", facts, timing: { shade: 5 } }) });
      this.onmessage({ data: await painted(number) });
      this.#drawn = null;
      if (this.#newest !== view || (!view.moving && step < LAST)) this.#draw();
    }

    close() {}
  }
  window.WebSocket = SlowStream;

  /** What the card drew last: the controls at the time, and the canvas's size. */
  let drawn = null;

  /** Note what the card draws. */
  async function watchCard() {
    const { Card } = await import("/web/card/card.js");
    const { draw } = Card.prototype;
    Card.prototype.draw = function (...given) {
      const done = draw.apply(this, given);
      if (done) drawn = { controls: controls(), size: sizeOf(this.canvas), facts: {}, draft: true };
      return done;
    };
  }

  const sizeOf = ({ width, height }) => `${width}×${height}`;

  const pixel = new OffscreenCanvas(1, 1).getContext("2d", { willReadFrequently: true });

  /** The picture that a person sees, and the element that shows it; null where there is none. */
  function seen() {
    const live = $("#live");
    if (!live.hidden && !live.hasAttribute("data-faded")) return { node: live, picture: drawn };
    const node = $("#draft").hidden ? $("#picture") : $("#draft");
    if (node.hidden) return null;
    pixel.drawImage(node, 0, 0, 1, 1);
    const [r, g, b] = pixel.getImageData(0, 0, 1, 1).data;
    return { node, picture: pictures.get((r << 16) | (g << 8) | b) };
  }

  const told = () => Object.fromEntries(["#badge", "#status-line", "#announce", "#error .value", "#error .note", "#error .legend .final b"].map((each) => [each, $(each).textContent]));

  /** When the controls left what they were, by what they were. */
  const left = new Map();
  const leave = (text) => left.set(text, { moment: performance.now(), looks: report.looks });
  let before = "";

  /** When the card's picture was last seen: what comes to light under it is dimmed from then on. */
  let covered = { moment: 0, looks: 0 };

  /** What is untrue of a picture of the card: what is said may be how far the light of its view is, and what it predicts. */
  function liesOfCard(picture, now) {
    const said = told();
    const found = [];
    const badge = picture.controls === now ? [...WAITS, "Preview"] : WAITS;
    if (picture.controls === now) {
      said["#status-line"] = said["#status-line"].replace(PREDICTED, "");
      if (said["#badge"] === "Preview") said["#status-line"] = said["#status-line"].replace(/^Preview, .* left$/, "");
      if (said["#badge"] === "Preview") said["#announce"] = said["#announce"].replace(/^Refining, (not lit everywhere yet|lit everywhere)$/, "");
    }
    for (const [where, text] of Object.entries(said)) if (CLAIM.test(text)) found.push(["claim for the card's picture", `${where}: ${text}`]);
    if (!badge.includes(said["#badge"])) found.push(["not said of the card's picture", `“${said["#badge"]}” for ${differing(picture.controls, now)}`]);
    if (picture.size !== sizeOf($("#live"))) found.push(["black", `${sizeOf($("#live"))}, drawn at ${picture.size}`]);
    if (!$("#error-scale").hidden) found.push(["legend of no colours", "of the card's picture"]);
    return found;
  }

  /** What is untrue of what is seen now: names, and what shows it. */
  function lies() {
    const now = controls();
    if (before !== now) leave(before);
    left.delete(now);
    before = now;
    const { node, picture } = seen() ?? {};
    if (!picture) return [];
    if (node === $("#live")) {
      report.drawn += 1;
      covered = { moment: performance.now(), looks: report.looks };
      return liesOfCard(picture, now);
    }
    const said = told(), bar = $("#progress").getAttribute("aria-valuenow");
    const found = [];
    const { error, provisional } = picture.facts, percent = `${Number((100 * error).toPrecision(2))} %`;
    const ofThese = picture.controls === now;
    if (!ofThese || picture.draft) {
      for (const [where, text] of Object.entries(said)) if (CLAIM.test(text)) found.push([picture.draft && ofThese ? "claim for a draft" : "claim for an old picture", `${where}: ${text}`]);
      if (bar !== null) found.push([picture.draft && ofThese ? "bar for a draft" : "bar for an old picture", bar]);
      if (!WAITS.includes(said["#badge"])) found.push(["not said", `“${said["#badge"]}” for ${differing(picture.controls, now)}`]);
    } else {
      for (const where of ["#badge", "#status-line", "#error .value"]) {
        if (/\d %/.test(said[where]) && !said[where].includes(percent)) found.push(["another's error", `${where}: ${said[where]}, it is ${percent}`]);
      }
      if (bar !== null && (Number(bar) === 100) === provisional) found.push(["another's bar", bar]);
    }
    const { moment = Infinity, looks = Infinity } = ofThese ? {} : left.get(picture.controls) ?? {};
    const old = performance.now() - Math.max(moment, covered.moment);
    if (old > OLD_MS && report.looks - Math.max(looks, covered.looks) > OLD_FRAMES && Number(getComputedStyle(node).opacity) > DIM) found.push(["not dimmed", `${Math.round(old)} ms: ${differing(picture.controls, now)}`]);
    const angle = Math.round(picture.view.azimuth);
    if (!$("#picture").alt.includes(`azimuth ${angle}°`)) found.push(["another's words", `${$("#picture").alt}, it is ${angle}°`]);
    if ($("#error-scale").hidden === (picture.view.overlay === "error")) found.push(["another's legend", picture.view.overlay]);
    return found;
  }

  /** Look now, and keep what is untrue, each kind once a change. */
  function look() {
    report.looks += 1;
    for (const [kind, why] of lies()) {
      const known = report.lies.some((each) => each.change === report.changes && each.kind === kind);
      if (!known) report.lies.push({ change: report.changes, after: report.after, kind, why });
    }
  }

  /** A person is about to change something. */
  report.begin = (what) => {
    report.changes += 1;
    report.after = what;
  };
  /** Whether the picture of these controls is there, final, and told with its error. */
  report.rests = () => {
    const { node, picture } = seen() ?? {};
    if (node === $("#live")) return false;
    const error = picture && `Done, ${Number((100 * picture.facts.error).toPrecision(2))} % error`;
    return Boolean(picture) && picture.controls === controls() && !picture.facts.provisional && $("#status-line").textContent === error && Number(getComputedStyle($("#picture")).opacity) === 1;
  };
  addEventListener("pagehide", () => sessionStorage.setItem("report", JSON.stringify(report)));

  const { port1, port2 } = new MessageChannel();
  port2.onmessage = look;
  const watch = () => {
    if (!$("#controls")?.inert) port1.postMessage(null); // once the frame has been painted
    requestAnimationFrame(watch);
  };
  addEventListener("DOMContentLoaded", () => {
    watchCard();
    watch();
    new ResizeObserver(([{ contentRect: { width, height } }]) => { size = `${width}×${height}`; }).observe($("#stage"));
  });
})();
