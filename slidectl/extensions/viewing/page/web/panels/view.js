// What is drawn in the scene. All browsers of the page see the same scene.

import { Act, attempt, Check, Field, Group, html, page, Select, store, useStore } from "../parts.js";

const BOXES = [
  ["collisions", "Collision shapes instead of visuals"],
  ["frames", "Frames of links, with names"],
  ["axes", "Joint axes"],
  ["masses", "Centres of mass"],
  ["contacts", "Contacts and their forces"],
];

const ask = (what, request) => attempt(async () => {
  await page(what, request);
  await store.values.readWorld();
});
const choose = (changes) => ask("view", changes);

/** The topics that can be drawn in the scene, where there are any. */
function Sensors({ shown, drawn }) {
  const topics = useStore((s) => s.topics);
  const found = Object.values(topics).filter((one) => drawn.includes(one.type) && (one.publishers.length || one.name in shown));
  if (!found.length) return null;
  return html`<${Group} title="Sensors and paths">
    ${found.map(({ name, type }) => html`<div key=${name}><${Check} checked=${name in shown}
        onChange=${(value) => ask("sensor", { topic: name, shown: value })}><span title=${type}>${name}</span><//>
      ${shown[name] && html`<p class="hint" role="status">${shown[name]}</p>`}</div>`)}
  <//>`;
}

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
    <${Sensors} shown=${view.sensors} drawn=${view.drawn_types} />
    <${Group} title="Trace">
      <${Field} label="Trace of a link"><${Select} label="Trace of a link" value=${view.trace} options=${[["", "None"], ...links]}
        onChange=${(trace) => choose({ trace })} /><//>
    <//>
    <${Group} title="Quality">
      <${Field} label="Shadows" hint="Half of the frames of a browser that draws by software"><${Select} label="Shadows" value=${view.shadows}
        options=${[["auto", view.shadows === "auto" ? `Auto (${view.has_shadows ? "on" : "off"})` : "Auto"], ["on", "On"], ["off", "Off"]]} onChange=${(shadows) => choose({ shadows })} /><//>
      ${view.shadows === "auto" && !view.has_shadows && html`<p class="hint">Off while a browser draws by software.</p>`}
    <//>
    ${!readOnly && html`<${Group} title="Mouse">
      <${Field} label="Place a robot"><${Select} label="Place with the mouse" value=${view.placed} disabled=${!free.length}
        options=${[["", free.length ? "None" : "No free robot"], ...free]}
        onChange=${(robot) => ask("place", { robot })} /><//>
      <p class="hint">Shift and drag pushes a link.</p>
    <//>`}`;
}

export const viewPanel = { title: "View", Panel };
