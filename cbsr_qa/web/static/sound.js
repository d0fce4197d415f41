// Sounds of a station, made here: one for the end of measuring, a pass, a fail, and what needs attention.

// Tones of each sound: begin [s], length [s], pitch [Hz]. A pass rises, a fail falls, attention repeats.
const TONES = {
  end: [[0, 0.35, 660]],
  pass: [[0, 0.14, 660], [0.15, 0.14, 880], [0.3, 0.35, 1320]],
  fail: [[0, 0.3, 440], [0.32, 0.3, 330], [0.64, 0.6, 220]],
  attention: [[0, 0.16, 988], [0.24, 0.16, 988], [0.48, 0.16, 988]],
};
const LOUDNESS = 0.25;
const KEPT = "cbsr-qa muted";

const button = document.getElementById("mute");
let muted = localStorage.getItem(KEPT) === "yes";
let context = null;
let lastCue = null;

const isBlocked = () => !muted && context?.state !== "running";
function show() {
  if (!button) return;
  button.textContent = muted ? button.dataset.off : isBlocked() ? button.dataset.blocked : button.dataset.on;
  button.setAttribute("aria-pressed", String(muted));
}

// A browser allows sound once somebody has clicked or typed, or if it was started so.
async function allow() {
  if (!button || muted) return;
  context ??= new AudioContext();
  if (context.state !== "running") await Promise.race([context.resume(), new Promise((end) => setTimeout(end, 300))]);
  show();
}

function play(kind) {
  if (muted || !TONES[kind] || context?.state !== "running") return;
  for (const [begin, length, pitch] of TONES[kind]) {
    const at = context.currentTime + begin;
    const tone = new OscillatorNode(context, { frequency: pitch, type: "triangle" });
    const volume = new GainNode(context, { gain: 0 });
    volume.gain.setTargetAtTime(LOUDNESS, at, 0.01);  // without a click
    volume.gain.setTargetAtTime(0, at + length - 0.04, 0.01);
    tone.connect(volume).connect(context.destination);
    tone.start(at);
    tone.stop(at + length);
  }
}

// What a page shows when it is opened makes no sound, nor what it shows again after a lost connection. A cue of one
// word belongs to an answer, and passes.
export function hear(cue = "") {
  if (lastCue !== null && cue && cue !== lastCue) play(cue.split(" ")[0]);
  if (!cue || cue.includes(" ")) lastCue = cue;
}

let wasBlocked = false;  // before the click that allows sound
button?.addEventListener("click", () => {
  if (!wasBlocked) muted = !muted;
  localStorage.setItem(KEPT, muted ? "yes" : "no");
  show();
  allow();
});
for (const gesture of ["keydown", "pointerdown"]) {
  document.addEventListener(gesture, () => { wasBlocked = isBlocked(); allow(); }, { capture: true });
}
show();
allow();
