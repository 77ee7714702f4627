// What is drawn in the scene. All browsers of the page see the same scene.

import { Act, attempt, Check, Field, Group, html, page, Select, store, useStore } from "../parts.js";

const BOXES = [
  ["collisions", "Collision shapes instead of visuals"],
  ["frames", "Frames of links, with names"],
  ["axes", "Joint axes"],
  ["masses", "Centres of mass"],
  ["contacts", "Contacts and their forces"],
];

const choose = (changes) => attempt(async () => {
  await page("view", changes);
  await store.values.readWorld();
});

function Panel() {
  const view = useStore((s) => s.pageState?.view);
  const robots = useStore((s) => s.robots);
  const readOnly = useStore((s) => s.readOnly);
  if (!view) return null;
  const links = robots.flatMap((one) => one.links.filter((link) => link !== "world").map((link) => `${one.name}::${link}`));
  const free = robots.filter((one) => !one.fixed).map((one) => one.name);
  return html`
    <${Group} title="Show">
      ${BOXES.filter(([key]) => key in view).map(([key, text]) => html`<${Check} key=${key} checked=${view[key]}
        onChange=${(value) => choose({ [key]: value })}>${text}<//>`)}
    <//>
    <${Group} title="Trace">
      <${Field} label="Trace of a link"><${Select} label="Trace of a link" value=${view.trace} options=${[["", "none"], ...links]}
        onChange=${(trace) => choose({ trace })} /><//>
    <//>
    ${!readOnly && html`<${Group} title="Mouse">
      <${Field} label="Place with the mouse"><${Select} label="Place with the mouse" value=${view.placed} disabled=${!free.length}
        options=${[["", free.length ? "none" : "no free robot"], ...free]}
        onChange=${(robot) => attempt(async () => { await page("place", { robot }); await store.values.readWorld(); })} /><//>
      <p class="hint">Shift and drag pushes a link.</p>
    <//>`}`;
}

export const viewPanel = { title: "View", Panel };
