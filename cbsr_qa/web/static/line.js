// Shows what the server sends, and sends what the operator asks for. Without it the pages are still readable.

import { followBurst, takeBurst } from "./bursts.js";
import "./marks.js";
import { keepName, readName, showName } from "./operators.js";
import { hear } from "./sound.js";

const body = document.body;
const say = document.getElementById("say");
const connection = document.getElementById("connection");

let lastKey = 0;
const isTyping = () => Date.now() - lastKey < 500 && document.activeElement?.matches("input");

// After an emergency stop the station stays red while the run comes to its end, for five seconds at most.
let redUntil = 0;
let late = 0;

// What is shown already is not replaced: somebody may be typing in it. What was typed is kept.
const keys = JSON.parse(body.dataset.keys ?? "{}");
function put([id, html, key]) {
  const place = document.getElementById(id);
  if (!place || (key && keys[id] === key)) return;
  if (id === "state" && key) {
    clearTimeout(late);
    if (Date.now() < redUntil && /class="board (running|paused|asking)/.test(html)) {
      late = setTimeout(put, redUntil - Date.now(), [id, html, key]);
      return;
    }
  }
  if (key) keys[id] = key;
  const fields = key ? [...place.querySelectorAll("input[id]:not([type=hidden])")] : [];  // an answer clears them
  const typed = fields.filter((one) => one.value !== one.defaultValue);
  const focused = place.contains(document.activeElement) ? document.activeElement.id : "";
  place.innerHTML = html;
  prepare(place);
  for (const one of typed) {
    const field = document.getElementById(one.id);
    if (field && one.form?.action === field.form?.action) field.value = one.value;
  }
  if (id === "state" && key) settle();
  const first = place.querySelector("[autofocus]:not([popover] *)");
  const before = focused && document.getElementById(focused);
  // Half a serial number must not go elsewhere: whoever is typing keeps the focus.
  if (before) before.focus();
  else if (first && !isTyping() && !isHalfTyped() && !isStated(document.activeElement)) first.focus();
}

// What the browser remembers: who works here, and which details are open.
function prepare(place) {
  showName(place);
  for (const field of place.querySelectorAll("[data-me]")) field.value = readName(field.form)[1];
  for (const details of place.querySelectorAll("[data-kept]")) {
    details.open = localStorage.getItem(`cbsr-qa ${details.dataset.kept}`) === "open";
    details.addEventListener("toggle", () => {
      localStorage.setItem(`cbsr-qa ${details.dataset.kept}`, details.open ? "open" : "closed");
    });
  }
}

// A message that something was asked for goes once the station shows another state.
let turnOfState = 0;
function settle() {
  turnOfState += 1;
  if (say.dataset.passes === "true") tell("");
}
function tell(words, { passes = false, refused = false } = {}) {
  say.textContent = words;
  say.dataset.passes = passes;
  say.classList.toggle("refused", refused);
  if (words && !refused) setTimeout(() => { if (say.textContent === words) tell(""); }, 15000);
}

// The next picture is decoded before it replaces the last one, so that nothing flickers.
let wanted = "";
async function show(address) {
  wanted = address;
  const next = new Image();
  next.src = address;
  try { await next.decode(); } catch { return; }
  const shown = document.getElementById("image");
  if (shown && wanted === address) {
    shown.setAttribute("href", address);
    shown.dataset.shown = Date.now();
  }
}

function take({ parts = [], picture = "", words = "", passes = false, refused = false, fields = {} }, asked = turnOfState) {
  if (picture) show(picture);  // it is fetched while parts are laid out
  const ready = shownSerial();
  parts.forEach(put);
  const begun = document.querySelector("#state .serial")?.textContent;
  if (ready && !shownSerial() && parts.some(([id, , key]) => id === "body" && key) && begun !== ready) {
    tell(body.dataset.gone.replace("{}", ready), { refused: true });
  }
  for (const [id, value] of Object.entries(fields)) {
    const field = document.getElementById(id);
    const isSerial = id === "serial";
    if (field && !(isSerial && isHalfTyped())) field.value = value;
    if (field && isSerial && field.value === value) sentSerial = value;  // nobody typed it
    if (field && id === "operator") keepName(field.form, value);
  }
  if (restated) holdStart();
  if (fields.serial === "" && !isTyping()) document.getElementById("serial")?.focus();
  if (parts.some(([id]) => id === "state")) hear(document.querySelector("[data-cue]")?.dataset.cue);
  if (words && !(passes && asked !== turnOfState)) tell(words, { passes, refused });
}
prepare(document);
hear(document.querySelector("[data-cue]")?.dataset.cue);

// One stream for each page that is looked at: a browser allows six connections to a server. A lost one is tried again
// at once, then more slowly, and at least twice a second.
const RETRY_MS = [50, 150, 250, 400];
let stream = null;
let lastHeard = 0;
let tries = 0;
let waiting = 0;
function lost(yes) {
  connection.textContent = yes ? body.dataset.lost : "";
  body.classList.toggle("lost", yes);
}
function heard() {
  lastHeard = Date.now();
  tries = 0;
  lost(false);
}
function listen() {
  clearTimeout(waiting);
  if (stream || !body.dataset.stream || document.hidden) return;
  const mine = stream = new EventSource(body.dataset.stream);
  mine.onopen = heard;
  mine.onmessage = (event) => { heard(); take(JSON.parse(event.data)); };
  mine.addEventListener("here", heard);
  mine.onerror = () => { if (mine === stream) again(); };
  // An attempt that is not answered, as by a server that is only beginning, is given up.
  setTimeout(() => { if (mine === stream && mine.readyState === EventSource.CONNECTING) again(); }, 5000);
}
function again() {
  lost(true);
  leave();
  const wait = RETRY_MS[Math.min(tries++, RETRY_MS.length - 1)];
  waiting = setTimeout(listen, wait * (0.75 + Math.random() / 2));  // not all pages at once
}
function leave() {
  clearTimeout(waiting);
  stream?.close();
  stream = null;
}
document.addEventListener("visibilitychange", () => (document.hidden ? leave() : listen()));
setInterval(() => { if (stream && lastHeard && Date.now() - lastHeard > 15000) again(); }, 3000);
addEventListener("pageshow", listen);
addEventListener("online", listen);
addEventListener("pagehide", leave);
listen();

// The serial number as it was sent last, and keys that came before its check was answered.
let sentSerial = "";
let checking = 0;
let early = "";
let earlySince = 0;
let lastEarly = 0;
function isHalfTyped() {
  const serial = document.getElementById("serial");
  return Boolean(serial?.value) && serial.value !== sentSerial;
}

// Recipe, operator, batch and parts of the sensor that is shown: if one is changed, the sensor is checked again before
// it can be started, once the field is left: half a word is not wrong yet.
const shownSerial = () => document.querySelector("#gate [data-serial]")?.dataset.serial ?? "";
const isStated = (field) => field?.id !== "serial" && field?.form && field.form === document.getElementById("serial")?.form;
let restated = false;
function holdStart() {
  for (const button of document.querySelectorAll("#gate form[action$='/start'] button")) button.disabled = true;
  for (const why of document.querySelectorAll("#gate .restated")) why.hidden = false;
}
function showWrong(wrong = {}) {
  for (const place of document.querySelectorAll(".wrong")) {
    const name = place.id.replace("-wrong", "");
    place.textContent = wrong[name] ?? "";
    document.getElementById(name).toggleAttribute("aria-invalid", name in wrong);
  }
}
function checkAgain() {
  const serial = document.getElementById("serial");
  if (!serial || !shownSerial() || isHalfTyped()) return;
  serial.value = shownSerial();
  serial.form.requestSubmit();
}
document.addEventListener("input", (event) => {
  if (event.target.id === "batch") document.getElementById("recalled").value = "";  // stated by a person
  if (!isStated(event.target) || !shownSerial()) return;
  restated = true;
  showWrong();
  holdStart();
});
document.addEventListener("change", (event) => {
  if (event.target.id === "operator") keepName(event.target.form, event.target.value);
});
for (const kind of ["change", "focusout"]) {
  document.addEventListener(kind, (event) => { if (restated && isStated(event.target)) checkAgain(); });
}

// A page of a sensor leads here to test it again: as if it had been scanned.
const asked = new URLSearchParams(location.search);
if (asked.has("serial")) {
  history.replaceState(null, "", location.pathname);
  const serial = document.getElementById("serial");
  const recipe = [...document.querySelectorAll("#recipe option")].find((one) => one.value === asked.get("recipe"));
  if (recipe) recipe.selected = true;
  if (serial) serial.value = asked.get("serial");
  if (serial) setTimeout(() => serial.form.requestSubmit());
  else tell(body.dataset.ignored);
}

let turn = 0;
document.addEventListener("submit", async (event) => {
  const form = event.target;
  if (!form.matches("[data-send]")) return;
  event.preventDefault();
  const button = event.submitter ?? form.querySelector("button");
  const latest = form.hasAttribute("data-latest");  // a newer scan replaces one whose answer is awaited
  if (!latest && button?.getAttribute("aria-busy") === "true") return;
  const mine = ++turn;
  const asked = turnOfState;
  button?.setAttribute("aria-busy", "true");
  tell("");
  document.querySelector(":popover-open")?.hidePopover();
  const fields = new URLSearchParams(new FormData(form));
  const name = fields.get("operator") ?? document.getElementById("operator")?.value;
  if (name !== undefined) keepName(form, name);
  if (!fields.has("operator") && !fields.has("by")) fields.set("by", readName(form)[1]);
  if (latest) {
    restated = false;
    fields.set("checked", shownSerial());
    [sentSerial, checking, early] = [fields.get("serial"), mine, ""];
    if (document.activeElement?.id === "serial") document.activeElement.select();  // the next scan replaces it
  }
  const board = form.dataset.stops && document.querySelector("#state .board");
  const shownBefore = board?.cloneNode(true);
  const showBefore = () => {
    redUntil = 0;
    board?.replaceWith(shownBefore);
  };
  if (board) {
    redUntil = Date.now() + 5000;
    board.className = "board emergency";
    board.querySelector("p").textContent = form.dataset.stops;
  }
  try {
    const answer = await fetch(form.action, { method: "POST", body: fields, signal: AbortSignal.timeout(30000) });
    if (latest && mine !== turn) return;
    const said = answer.headers.get("content-type")?.startsWith("application/json") ? await answer.json() : null;
    if (!said?.passes) showBefore();
    if (latest) showWrong(said?.wrong);
    if (said) take(said, asked);
    else tell(await answer.text(), { refused: true });
  } catch {
    lost(true);
    showBefore();
    tell(form.dataset.unsent ?? body.dataset.unsent, { refused: true });
  } finally {
    button?.removeAttribute("aria-busy");
    if (checking === mine) typeEarly();
  }
});

// Keys that were typed while a check was awaited: the PIN it asks for, or the beginning of the next serial number. A
// scanner types faster than people, and ends with Enter: that is another sensor.
const isScanned = () => early.length > 2 && lastEarly - earlySince < 50 * early.length;
function typeEarly() {
  checking = 0;
  const pin = isScanned() ? null : document.getElementById("pin");
  const field = pin ?? document.getElementById("serial");
  if (early && field) {
    field.value = early;
    field.focus();
  }
  early = "";
}
function keepEarly(event) {
  if (event.key.length === 1) {
    lastEarly = Date.now();
    if (!early) earlySince = lastEarly;
    early += event.key;
  } else if (event.key === "Backspace") early = early.slice(0, -1);
  else if (event.key !== "Enter") return;
  event.preventDefault();
  const serial = document.getElementById("serial");
  if (event.key === "Enter" && serial && isScanned()) {
    serial.value = early;
    serial.form.requestSubmit();
  }
}

function scan(text) {
  const serial = document.getElementById("serial");
  if (!serial) tell(body.dataset.ignored);
  else {
    serial.value = text;
    serial.focus();
    serial.form.requestSubmit();
  }
}

// What a scanner types goes to the scan field, unless a text is being typed. Where there is none, during a run, it is
// ignored, with its Enter: neither may press a button.
let ignored = 0;
document.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.altKey || event.metaKey) return;
  const active = document.activeElement;
  if (checking && !active?.matches("input:not(#serial), textarea, select")) {
    keepEarly(event);
    return;
  }
  const scanned = event.key === "Enter" ? takeBurst(event) : "";
  if (scanned) {
    event.preventDefault();
    lastKey = 0;
    scan(scanned);
    return;
  }
  followBurst(event);
  if (event.key === "Enter") lastKey = 0;
  if (event.key === "Enter" && active?.id === "confirm-by") {  // a scanner's Enter is nobody's word: a press is
    event.preventDefault();
    return;
  }
  const serial = document.getElementById("serial");
  if (event.key === "Enter" && isStated(active) && active.matches("input") && serial.value === "") {
    event.preventDefault();
    serial.focus();
    return;
  }
  if (event.key === "Enter" && Date.now() - ignored < 1000) {
    event.preventDefault();
    ignored = 0;
    tell(body.dataset.ignored);
    return;
  }
  if (event.key.length !== 1) return;
  const before = lastKey;
  lastKey = Date.now();
  if (active?.matches("input, textarea") || (event.key === " " && lastKey - before > 500)) return;
  if (serial) {
    serial.value = "";
    serial.focus();
  } else if (body.dataset.ignored) {
    event.preventDefault();
    ignored = lastKey;
  }
});
