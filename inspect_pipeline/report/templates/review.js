"use strict";
// Decide by keys or buttons without loading the page again. Without this script, the buttons load it.
(() => {
  const status = document.querySelector("[role=status]");
  const findings = () => [...document.querySelectorAll(".finding")];
  const verdictOf = (finding) => finding.querySelector(".verdict").textContent;

  function count() {
    for (const item of document.querySelectorAll(".counts li")) {
      const priority = item.dataset.priority;
      item.querySelector("b").textContent = document.querySelectorAll(`.finding.open.${priority}`).length;
    }
    for (const item of document.querySelectorAll(".short li")) {
      const finding = document.getElementById(item.querySelector("a").hash.slice(1));
      item.classList.toggle("decided", !finding.classList.contains("open"));
    }
  }

  async function decide(finding, verdict) {
    const form = finding.querySelector(".decide");
    const body = new URLSearchParams(new FormData(form));
    body.set("verdict", verdict);
    let text;
    try {
      const answer = await fetch(form.action, { method: "POST", body, headers: { Accept: "application/json" } });
      if (!answer.ok) throw new Error(await answer.text());
      const review = await answer.json();
      finding.classList.remove("open", "confirmed", "dismissed");
      finding.classList.add(review.verdict);
      finding.querySelector(".verdict").textContent = review.verdict;
      text = `Finding ${finding.querySelector(".badge .number").textContent}: ${review.verdict}.`;
      count();
    } catch (error) {
      text = `Not saved: ${error.message}`;
    }
    status.textContent = text;
    return text;
  }

  async function decideAndMoveOn(finding, verdict) {
    await decide(finding, verdict);
    const all = findings();
    const following = all.slice(all.indexOf(finding) + 1).find((one) => one.classList.contains("open"));
    const next = verdict === "open" ? finding : following || finding;
    next.focus({ preventScroll: true });
    next.scrollIntoView({ block: "start" });
  }

  document.addEventListener("submit", (event) => {
    const finding = event.target.closest(".finding");
    if (!finding) return;
    event.preventDefault();
    const button = event.submitter;
    if (button && !button.hidden) decideAndMoveOn(finding, button.value);
    else if (verdictOf(finding) !== "open") decide(finding, verdictOf(finding));  // a note to a decision
    else status.textContent = "The note is saved with your decision.";
  });
  document.addEventListener("keydown", (event) => {
    const finding = event.target.closest(".finding");
    if (!finding || event.target.matches("input") || event.ctrlKey || event.metaKey || event.altKey) return;
    const verdict = { c: "confirmed", d: "dismissed", o: "open" }[event.key];
    if (verdict) decideAndMoveOn(finding, verdict);
    else if (event.key === "n") {
      event.preventDefault();
      finding.querySelector("input[name=note]").focus();
    }
  });
})();
