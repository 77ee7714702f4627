// The log: messages on /rosout, by severity and text. The lines stay when the daemon ends and when another panel is shown.

import { Button, html, Select, store, useEffect, useState } from "../parts.js";

const LEVELS = [["1", "debug"], ["2", "info"], ["4", "warn"], ["8", "error"], ["16", "fatal"]];
const MOST_KEPT = 2000;
const MOST_SHOWN = 200;
const LONGEST = 500;
const lines = [];
let serial = 0;
let paused = false;
let severity = 1;
let text = "";
let isSubscribed = false;

function take(msg) {
  const name = LEVELS.find(([level]) => Number(level) >= msg.level)?.[1] ?? "fatal";
  const time = (msg.header.stamp.secs + msg.header.stamp.nsecs / 1e9).toFixed(3);
  const whole = `${msg.name}: ${msg.msg}`;
  lines.push({ id: ++serial, level: msg.level, name, time, text: whole.length > LONGEST ? `${whole.slice(0, LONGEST)} …` : whole });
  if (lines.length > MOST_KEPT) lines.splice(0, lines.length - MOST_KEPT);
}

function Panel() {
  const [, again] = useState(0);
  const draw = () => again((count) => count + 1);
  useEffect(() => {
    let seen = serial;
    const timer = setInterval(() => {
      if (seen !== serial && !paused && !document.hidden) {
        seen = serial;
        draw();
      }
    }, 200);
    return () => clearInterval(timer);
  }, []);
  const wanted = text.toLowerCase();
  const shown = lines.filter((one) => one.level >= severity && `${one.time} ${one.name} ${one.text}`.toLowerCase().includes(wanted));
  return html`<div class="line">
      <${Select} label="Severity from" value=${String(severity)} options=${LEVELS.map(([level, name]) => [level, `From ${name}`])} onChange=${(value) => { severity = Number(value); draw(); }} />
      <input aria-label="Log contains" placeholder="Contains" value=${text} onInput=${(event) => { text = event.target.value; draw(); }} />
      <${Button} icon=${paused ? "play" : "pause"} title=${paused ? "Go on with the log" : "Pause the log"} aria-pressed=${paused} onClick=${() => { paused = !paused; draw(); }} />
      <${Button} title="Clear the log" onClick=${() => { lines.length = 0; draw(); }}>Clear<//></div>
    <div class="log" tabindex="0" aria-label="Log"><div>${shown.slice(-MOST_SHOWN).map((one) => html`<p key=${one.id} class=${one.name}>
      <time>${one.time}</time> <b>${one.name}</b> ${one.text}</p>`)}${!shown.length && html`<p class="empty">${lines.length ? "No lines match." : "No lines yet."}</p>`}</div></div>`;
}

/** Follow the log from the beginning of the page on. */
export function followLog() {
  if (isSubscribed) return;
  isSubscribed = true;
  store.values.ros.subscribe("/rosout", take, { type: "rosgraph_msgs/Log", queue: MOST_KEPT });
}

export const logPanel = { title: "Log", Panel };
