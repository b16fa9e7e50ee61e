"use strict";
// j and k move from finding to finding. Everything else on the page works without this script.
(() => {
  const findings = [...document.querySelectorAll(".finding")];
  let current = -1;

  function show(number) {
    current = Math.max(0, Math.min(number, findings.length - 1));
    const finding = findings[current];
    finding.focus({ preventScroll: true });
    finding.scrollIntoView({ block: "start" });
  }

  document.addEventListener("focusin", (event) => {
    const number = findings.indexOf(event.target.closest(".finding"));
    if (number >= 0) current = number;
  });
  document.addEventListener("keydown", (event) => {
    const isTyping = event.target.matches("input, textarea, select");
    if (isTyping || event.ctrlKey || event.metaKey || event.altKey || !findings.length) return;
    if (event.key === "j") show(current + 1);
    else if (event.key === "k") show(current - 1);
  });
})();
