"use strict";
// The report's controls: the viewer with its timeline, and the strips of worst and best grasps.

(() => {
  const find = (id) => document.getElementById(id);
  const stage = find("stage");
  if (!stage) return;
  const scene = Replays.decode(JSON.parse(find("replay-data").textContent));
  let draw = null;
  try { draw = Replays.painter(); } catch (error) { console.error(error); }
  if (!draw) {
    find("no-webgl").hidden = false;
    document.documentElement.dataset.viewer = "none";
    return;
  }
  const slider = find("scrub"), play = find("play"), speed = find("speed"), box = find("viewer");
  const shapes = find("shapes");
  const thumbs = [...document.querySelectorAll("button.thumb")];
  const state = { at: 0, frame: 0, playing: false, dirty: true, hovered: null, hoverFrame: 0 };
  const view = { yaw: 0, pitch: 0.35, zoom: 1 };
  let colors;

  function readColors() {
    const style = getComputedStyle(document.documentElement);
    const rgba = (name) => style.getPropertyValue(name).trim().split(/[\s,]+/).map(Number);
    colors = Object.fromEntries(["hand", "contact", "object", "table", "shadow", "ghost", "edge"].map((k) =>
      [k, rgba(`--gl-${k}`)]));
    redraw();
  }

  function redraw() {
    thumbs.forEach(drawThumb);
    state.dirty = true;
  }

  function setShapes(on) {
    shapes.checked = on && scene.shapes !== null;
    find("ghost-key").hidden = !shapes.checked;
    redraw();
  }

  const current = () => scene.replays[state.at];
  const homeView = (r) => ({ yaw: r.yaw, pitch: 0.35, zoom: r.zoom });

  function fit(canvas) {
    const ratio = Math.min(window.devicePixelRatio || 1, 2);
    const width = Math.round(canvas.clientWidth * ratio), height = Math.round(canvas.clientHeight * ratio);
    if (width && height && (canvas.width !== width || canvas.height !== height)) {
      canvas.width = width;
      canvas.height = height;
    }
  }

  // The most informative frame: just after the loss, or the end of the window.
  function telling(r) {
    const loss = Replays.lossFrame(r);
    return loss === null ? r.n - 1 : Math.min(r.n - 1, loss + 0.08 / r.dt);
  }

  function drawThumb(button) {
    const r = scene.replays[Number(button.dataset.replay)], canvas = button.querySelector("canvas");
    fit(canvas);
    const frame = state.hovered === button ? state.hoverFrame : telling(r);
    draw(canvas, scene, r, frame, { ...homeView(r), zoom: 1.25 * r.zoom }, colors, shapes.checked);
  }

  function show() {
    const r = current(), frame = Math.min(state.frame, r.n - 1);
    const t = Replays.seconds(r, frame), loss = Replays.lossFrame(r);
    fit(stage);
    draw(stage, scene, r, frame, view, colors, shapes.checked);
    slider.value = frame;
    find("time").textContent = `${t < 0 ? "\u2212" : "+"}${Math.abs(t).toFixed(2)} s`;
    const lost = loss !== null && frame > loss + 0.5;
    const phases = r.stays ? ["grasping", "moving"] : ["table present", "table removed"];
    const phase = lost ? `lost (${r.outcome})` : phases[t < 0 ? 0 : 1];
    find("phase").textContent = phase;
    find("phase").dataset.lost = lost;
    stage.setAttribute("aria-label", `${r.object} ${r.index}, ${t.toFixed(2)} s, ${phase}`);
    document.documentElement.dataset.frame = frame.toFixed(2);
  }

  function select(at, keepView) {
    state.at = Math.max(0, Math.min(scene.replays.length - 1, at));
    const r = current(), loss = Replays.lossFrame(r), last = Math.max(r.n - 1, 1);
    if (!keepView) Object.assign(view, homeView(r));
    state.frame = 0;
    slider.max = r.n - 1;
    const mark = (id, frame) => {
      find(id).hidden = frame === null || frame < 0;
      if (frame !== null) find(id).style.left = `${(100 * Math.min(frame, last)) / last}%`;
    };
    mark("mark-table", r.start);
    find("mark-table").title = r.stays ? "the motion begins" : "the table is taken away";
    mark("mark-loss", loss);
    find("replay-title").textContent = `${r.object} [${r.index}]`;
    const facts = [r.lost_s === null ? r.outcome : `${r.outcome}, lost after ${r.lost_s.toFixed(2)} s`];
    const m = r.metrics;
    if (m.sim_dist_mm_per_step !== undefined) facts.push(`SimDist ${m.sim_dist_mm_per_step.toFixed(1)} mm/step`);
    if (m.contact_ratio !== undefined) facts.push(`contacts ${m.contact_ratio.toFixed(2)}`);
    if (m.interpenetration_cm3 !== undefined) facts.push(`interpenetration ${m.interpenetration_cm3.toFixed(2)} cm\u00b3`);
    if (m.mpe_m !== undefined) facts.push(`${(1000 * m.mpe_m).toFixed(0)} mm from the target`);
    if (m.geodesic_rad !== undefined) facts.push(`${m.geodesic_rad.toFixed(2)} rad`);
    find("replay-facts").textContent = facts.join(" \u00b7 ");
    thumbs.forEach((b) => b.setAttribute("aria-pressed", String(Number(b.dataset.replay) === state.at)));
    state.dirty = true;
  }

  function setPlaying(on) {
    state.playing = on;
    play.setAttribute("aria-label", on ? "Pause" : "Play");
    play.dataset.playing = on;
  }

  function scrub(frame) {
    setPlaying(false);
    state.frame = Math.max(0, Math.min(current().n - 1, frame));
    state.dirty = true;
  }

  function turn(dx, dy) {
    view.yaw -= dx;
    view.pitch = Math.max(-0.15, Math.min(1.5, view.pitch + dy));
    state.dirty = true;
  }

  function zoom(factor) {
    view.zoom = Math.max(0.3, Math.min(6, view.zoom * factor));
    state.dirty = true;
  }

  function full(on) {
    box.classList.toggle("full", on);
    document.body.classList.toggle("covered", on);
    state.dirty = true;
  }

  // ---- input -----------------------------------------------------------------------------------------------------
  const pointers = new Map();
  stage.addEventListener("pointerdown", (e) => {
    stage.setPointerCapture(e.pointerId);
    pointers.set(e.pointerId, [e.clientX, e.clientY]);
    stage.focus({ preventScroll: true });
  });
  stage.addEventListener("pointermove", (e) => {
    const before = pointers.get(e.pointerId);
    if (!before) return;
    const other = [...pointers].filter(([id]) => id !== e.pointerId).map(([, place]) => place)[0];
    if (other) {
      const apart = (p) => Math.hypot(p[0] - other[0], p[1] - other[1]);
      zoom(apart([e.clientX, e.clientY]) / Math.max(apart(before), 1));
    } else turn(0.009 * (e.clientX - before[0]), 0.007 * (e.clientY - before[1]));
    pointers.set(e.pointerId, [e.clientX, e.clientY]);
  });
  for (const end of ["pointerup", "pointercancel"]) stage.addEventListener(end, (e) => pointers.delete(e.pointerId));
  stage.addEventListener("wheel", (e) => {
    // Scrolling the page must not zoom when the pointer passes over the viewer.
    if (document.activeElement !== stage && !e.ctrlKey) return;
    e.preventDefault();
    zoom(Math.exp(-0.0015 * e.deltaY));
  }, { passive: false });
  box.addEventListener("keydown", (e) => {
    if (e.target === speed || (e.target === slider && e.key.startsWith("Arrow"))) return;
    const keys = { ArrowLeft: -1, ArrowRight: 1 };
    if (e.key in keys) scrub(Math.round(state.frame) + keys[e.key]);
    else if (e.key === "Escape") full(false);
    else if (e.key === " " && e.target === stage) setPlaying(!state.playing);
    else if (e.key === "s" && !e.ctrlKey && !e.metaKey && !e.altKey) setShapes(!shapes.checked);
    else return;
    e.preventDefault();
  });
  slider.addEventListener("input", () => scrub(Number(slider.value)));
  shapes.addEventListener("change", () => setShapes(shapes.checked));
  document.querySelectorAll(".of-shapes").forEach((e) => { e.hidden = scene.shapes === null; });
  play.addEventListener("click", () => setPlaying(!state.playing));
  find("home").addEventListener("click", () => { Object.assign(view, homeView(current())); state.dirty = true; });
  find("full").addEventListener("click", () => full(!box.classList.contains("full")));
  thumbs.forEach((button) => {
    button.addEventListener("click", () => { select(Number(button.dataset.replay)); setPlaying(true); });
    button.addEventListener("pointerenter", () => { state.hovered = button; state.hoverFrame = 0; });
    button.addEventListener("pointerleave", () => { state.hovered = null; drawThumb(button); });
  });
  new ResizeObserver(redraw).observe(document.body);
  // Redraw at once; otherwise the old picture is shown stretched until the next tick.
  new ResizeObserver(show).observe(stage);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", readColors);

  function follow(hash) {
    const wanted = Replays.readHash(hash), rad = Math.PI / 180;
    if ("replay" in wanted) select(wanted.replay);
    if ("yaw" in wanted) view.yaw = wanted.yaw * rad;
    if ("pitch" in wanted) view.pitch = Math.max(-0.15, Math.min(1.5, wanted.pitch * rad));
    if ("zoom" in wanted && wanted.zoom > 0) view.zoom = wanted.zoom;
    if ("shapes" in wanted) setShapes(wanted.shapes > 0);
    if ("full" in wanted) full(wanted.full > 0);
    if ("t" in wanted) scrub(wanted.t * (current().n - 1));
    state.dirty = true;
  }
  window.addEventListener("hashchange", () => follow(location.hash));

  // ---- the clock -------------------------------------------------------------------------------------------------
  let before = null;
  function tick(now) {
    const passed = before === null ? 0 : Math.min((now - before) / 1000, 0.1);
    before = now;
    if (state.playing) {
      const r = current();
      state.frame += (passed * Number(speed.value)) / r.dt;
      // The last frame stays for half a second.
      if (state.frame > r.n - 1 + 0.5 / r.dt) state.frame = 0;
      state.dirty = true;
    }
    if (state.hovered) {
      const r = scene.replays[Number(state.hovered.dataset.replay)];
      state.hoverFrame = (state.hoverFrame + passed / r.dt) % r.n;
      drawThumb(state.hovered);
    }
    if (state.dirty) {
      state.dirty = false;
      show();
    }
    requestAnimationFrame(tick);
  }

  select(0);
  readColors();
  setShapes(shapes.checked);
  setPlaying(!matchMedia("(prefers-reduced-motion: reduce)").matches);
  follow(location.hash);
  show();
  document.documentElement.dataset.viewer = "ready";
  requestAnimationFrame(tick);
})();
