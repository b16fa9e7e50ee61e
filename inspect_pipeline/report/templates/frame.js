"use strict";
// Mark lines that are wrong, draw those that are missed, and save all that are right.
(() => {
  const svg = document.querySelector(".editor");
  const form = document.querySelector("form.lines");
  const status = document.querySelector("[role=status]");
  const lines = svg.querySelector(".found");
  const draft = svg.querySelector(".draft");
  let points = [];

  function toPixel(event) {
    const at = new DOMPoint(event.clientX, event.clientY).matrixTransform(svg.getScreenCTM().inverse());
    const { width, height } = svg.viewBox.baseVal;
    const inside = [Math.min(Math.max(at.x, 0), width), Math.min(Math.max(at.y, 0), height)];
    return inside.map((value) => Math.round(value * 10) / 10);
  }

  function draw() {
    draft.setAttribute("points", points.map((point) => point.join(",")).join(" "));
    status.textContent = points.length ? `New line: ${points.length} points; Enter ends it.` : "";
  }

  function toggle(line) {
    const wrong = line.getAttribute("aria-pressed") !== "true";
    line.setAttribute("aria-pressed", wrong);
    status.textContent = wrong ? "This line is wrong." : "This line is right.";
  }

  function finish() {
    if (points.length < 2) return;
    const line = draft.cloneNode();
    line.removeAttribute("class");
    for (const [name, value] of Object.entries({
      stroke: "#ffffff", tabindex: 0, role: "button", "aria-pressed": false, "aria-label": "New line",
    })) line.setAttribute(name, value);
    lines.append(line);
    points = [];
    draw();
    status.textContent = "Line added.";
  }

  function kept() {
    return [...lines.children]
      .filter((line) => line.getAttribute("aria-pressed") !== "true")
      .map((line) => line.getAttribute("points").trim().split(/\s+/).map((pair) => pair.split(",").map(Number)));
  }

  svg.addEventListener("click", (event) => {
    if (event.target.parentNode === lines && !points.length) toggle(event.target);
    else if (event.detail < 2) {
      points.push(toPixel(event));
      draw();
    } else finish();
  });
  document.addEventListener("keydown", (event) => {
    if (event.target.parentNode === lines && (event.key === "Enter" || event.key === " ")) {
      event.preventDefault();
      toggle(event.target);
    } else if (event.key === "Enter" && points.length) {
      event.preventDefault();
      finish();
    } else if (event.key === "Backspace" && points.length) {
      points.pop();
      draw();
    } else if (event.key === "Escape") {
      points = [];
      draw();
    }
  });
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    finish();
    const body = new URLSearchParams({ lines: JSON.stringify(kept()) });
    try {
      const answer = await fetch(form.action, { method: "POST", body, headers: { Accept: "application/json" } });
      if (!answer.ok) throw new Error(await answer.text());
      status.textContent = `Saved: ${(await answer.json()).n_lines} lines.`;
    } catch (error) {
      status.textContent = `Not saved: ${error.message}`;
    }
  });
})();
