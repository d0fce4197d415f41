// Shows what the server sends, and sends what the operator asks for. Without it the pages are still readable.

const body = document.body;
const say = document.getElementById("say");
const connection = document.getElementById("connection");

let lastKey = 0;
const isTyping = () => Date.now() - lastKey < 500 && document.activeElement?.matches("input");

// What is shown already is not replaced: somebody may be typing in it.
const keys = JSON.parse(body.dataset.keys ?? "{}");
function put([id, html, key]) {
  const place = document.getElementById(id);
  if (!place || (key && keys[id] === key)) return;
  if (key) keys[id] = key;
  place.innerHTML = html;
  // Half a serial number must not go elsewhere: whoever is typing keeps the focus.
  if (!isTyping()) place.querySelector("[autofocus]:not([popover] *)")?.focus();
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

function take({ parts = [], picture = "", words = "" }) {
  if (picture) show(picture);  // it is fetched while parts are laid out
  parts.forEach(put);
  if (words) {
    say.textContent = words;
    setTimeout(() => { if (say.textContent === words) say.textContent = ""; }, 10000);
  }
}

// One stream for each page that is looked at: a browser allows six connections to a server.
let stream = null;
let lastHeard = 0;
function lost(yes) {
  connection.textContent = yes ? body.dataset.lost : "";
  body.classList.toggle("lost", yes);
}
function listen() {
  if (stream || !body.dataset.stream || document.hidden) return;
  stream = new EventSource(body.dataset.stream);
  stream.onopen = () => { lastHeard = Date.now(); lost(false); };
  stream.onmessage = (event) => { lastHeard = Date.now(); lost(false); take(JSON.parse(event.data)); };
  stream.addEventListener("here", () => { lastHeard = Date.now(); lost(false); });
  stream.onerror = () => { lost(true); again(); };
}
function again() {
  stream?.close();
  stream = null;
  setTimeout(listen, 500);
}
function leave() {
  stream?.close();
  stream = null;
}
document.addEventListener("visibilitychange", () => (document.hidden ? leave() : listen()));
setInterval(() => { if (stream && Date.now() - lastHeard > 15000) { lost(true); again(); } }, 3000);
addEventListener("pageshow", listen);
addEventListener("pagehide", leave);
listen();

let turn = 0;
document.addEventListener("submit", async (event) => {
  const form = event.target;
  if (!form.matches("[data-send]")) return;
  event.preventDefault();
  const button = event.submitter ?? form.querySelector("button");
  const latest = form.hasAttribute("data-latest");  // a newer scan replaces one whose answer is awaited
  if (!latest && button?.getAttribute("aria-busy") === "true") return;
  const mine = ++turn;
  button?.setAttribute("aria-busy", "true");
  say.textContent = "";
  say.classList.remove("unsent");
  document.querySelector(":popover-open")?.hidePopover();
  try {
    const fields = new URLSearchParams(new FormData(form));
    const answer = await fetch(form.action, { method: "POST", body: fields, signal: AbortSignal.timeout(30000) });
    if (latest && mine !== turn) return;
    if (answer.headers.get("content-type")?.startsWith("application/json")) take(await answer.json());
    else say.textContent = await answer.text();
  } catch {
    lost(true);
    say.classList.add("unsent");
    say.textContent = form.dataset.unsent ?? body.dataset.unsent;
  } finally { button?.removeAttribute("aria-busy"); }
});

// What a scanner types goes to the scan field, unless a text is being typed. Where there is none, during a run, it is
// ignored, with its Enter: neither may press a button.
let ignored = 0;
document.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.altKey || event.metaKey) return;
  const active = document.activeElement;
  if (event.key === "Enter") lastKey = 0;
  if (event.key === "Enter" && Date.now() - ignored < 1000) {
    event.preventDefault();
    ignored = 0;
    say.textContent = body.dataset.ignored;
    return;
  }
  if (event.key.length !== 1) return;
  const before = lastKey;
  lastKey = Date.now();
  if (active?.matches("input, textarea") || (event.key === " " && lastKey - before > 500)) return;
  const serial = document.getElementById("serial");
  if (serial) {
    serial.value = "";
    serial.focus();
  } else if (body.dataset.ignored) {
    event.preventDefault();
    ignored = lastKey;
  }
});
