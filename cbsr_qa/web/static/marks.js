// A place of the drawing opens its limit, and a limit that is open marks its place.
const LIMITS = "details[data-place]";
document.addEventListener("click", (event) => {
  const mark = event.target.closest?.("[data-mark]");
  if (!mark) return;
  event.preventDefault();
  const limit = [...document.querySelectorAll(LIMITS)].find((one) => one.dataset.place === mark.dataset.mark);
  for (let one = limit; one; one = one.parentElement.closest("details")) one.open = true;
  limit?.scrollIntoView({ block: "nearest" });
});
document.addEventListener("toggle", (event) => {
  if (!event.target.matches(LIMITS)) return;
  const places = [...document.querySelectorAll(`${LIMITS}[open]`)].map((one) => one.dataset.place);
  for (const mark of document.querySelectorAll("[data-mark]")) mark.classList.toggle("chosen", places.includes(mark.dataset.mark));
}, true);
