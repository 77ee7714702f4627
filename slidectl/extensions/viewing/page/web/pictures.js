// Images of topics, drawn live: raw ones in the usual encodings, depth as grey, and compressed ones.

import { Button, html, store, useEffect, useRef, useState, useStore } from "./parts.js";

const RAW = "sensor_msgs/Image";
const COMPRESSED = "sensor_msgs/CompressedImage";
const PERIOD_MS = 100;
const LATE_S = 3;

export const isPicture = (type) => type === RAW || type === COMPRESSED;

function bytesOf(text) {
  if (Uint8Array.fromBase64) return Uint8Array.fromBase64(text);
  const binary = atob(text);
  const bytes = new Uint8Array(binary.length);
  for (let place = 0; place < binary.length; place++) bytes[place] = binary.charCodeAt(place);
  return bytes;
}

const COLOURS = {
  rgb8: [3, 0, 1, 2], bgr8: [3, 2, 1, 0], rgba8: [4, 0, 1, 2], bgra8: [4, 2, 1, 0], mono8: [1, 0, 0, 0], "8UC1": [1, 0, 0, 0],
  "8UC3": [3, 2, 1, 0], "8UC4": [4, 2, 1, 0],
};

/** Grey of numbers between the lowest and the highest; what is not finite is black. */
function grey(read, width, height, pixels) {
  let [low, high] = [Infinity, -Infinity];
  const values = new Float32Array(width * height);
  for (let place = 0; place < values.length; place++) {
    const value = read(place);
    values[place] = value;
    if (Number.isFinite(value)) {
      low = Math.min(low, value);
      high = Math.max(high, value);
    }
  }
  const scale = high > low ? 230 / (high - low) : 0;
  for (let place = 0; place < values.length; place++) {
    const shade = Number.isFinite(values[place]) ? 255 - (values[place] - low) * scale : 0;
    pixels.set([shade, shade, shade, 255], 4 * place);
  }
  return high >= low ? `${low.toFixed(2)} to ${high.toFixed(2)}` : "nothing in range";
}

/** Draw a sensor_msgs/Image; the text that belongs under it. */
function drawRaw(canvas, message) {
  const { width, height, encoding, step } = message;
  if (!width || !height) return "an image without pixels";
  const bytes = bytesOf(message.data);
  if (bytes.length < step * height) return "an image with too little data";
  const image = new ImageData(width, height);
  const pixels = image.data;
  let about = "";
  if (encoding in COLOURS) {
    const [size, r, g, b] = COLOURS[encoding];
    for (let row = 0, to = 0; row < height; row++) {
      for (let from = row * step, end = from + width * size; from < end; from += size, to += 4) {
        pixels[to] = bytes[from + r];
        pixels[to + 1] = bytes[from + g];
        pixels[to + 2] = bytes[from + b];
        pixels[to + 3] = 255;
      }
    }
  } else if (["32FC1", "16UC1", "mono16"].includes(encoding)) {
    const view = new DataView(bytes.buffer, bytes.byteOffset);
    const size = encoding === "32FC1" ? 4 : 2;
    const little = !message.is_bigendian;
    const read = (place) => {
      const at = Math.floor(place / width) * step + (place % width) * size;
      return size === 4 ? view.getFloat32(at, little) : view.getUint16(at, little);
    };
    about = `${grey(read, width, height, pixels)}${size === 4 ? " m" : ""}`;
  } else {
    return `the encoding ${encoding} is not drawn`;
  }
  canvas.width = width;
  canvas.height = height;
  canvas.getContext("2d").putImageData(image, 0, 0);
  return [`${width} × ${height}`, encoding, about].filter(Boolean).join(", ");
}

async function drawCompressed(canvas, message) {
  const bitmap = await createImageBitmap(new Blob([bytesOf(message.data)]));
  canvas.width = bitmap.width;
  canvas.height = bitmap.height;
  canvas.getContext("2d").drawImage(bitmap, 0, 0);
  return `${bitmap.width} × ${bitmap.height}, ${message.format}`;
}

/** The live picture of a topic. */
export function Picture({ topic, type }) {
  const canvas = useRef();
  const [text, setText] = useState("");
  const [lateS, setLateS] = useState(0); // seconds without a picture, once they are too many
  useEffect(() => {
    let count = 0;
    let last = performance.now();
    let stamp = null;
    let rate = "";
    let isBusy = false;
    const end = store.values.ros.subscribe(topic, async (message, { time }) => {
      if (isBusy || document.hidden || !canvas.current) return;
      isBusy = true;
      last = performance.now();
      const now = time.secs + time.nsecs / 1e9;
      count += 1;
      if (stamp === null || now < stamp[0]) stamp = [now, count];
      else if (now - stamp[0] >= 1) {
        rate = `${((count - stamp[1]) / (now - stamp[0])).toFixed(1)} Hz`;
        stamp = [now, count];
      }
      try {
        const about = type === RAW ? drawRaw(canvas.current, message) : await drawCompressed(canvas.current, message);
        setText([about, rate].filter(Boolean).join(", "));
      } catch (error) {
        setText(`this picture cannot be drawn: ${error.message}`);
      }
      setLateS(0);
      isBusy = false;
    }, { throttle: PERIOD_MS });
    const timer = setInterval(() => {
      const passed = Math.floor((performance.now() - last) / 1000);
      setLateS(passed >= LATE_S ? passed : 0);
    }, 1000);
    return () => {
      clearInterval(timer);
      end();
    };
  }, [topic, type]);
  const paused = useStore((s) => s.status?.paused);
  const isPublished = useStore((s) => (s.topics[topic]?.publishers.length ?? 0) > 0);
  const why = !isPublished ? "the camera has gone" : paused ? "the world is paused" : "the camera has stopped";
  return html`<figure class=${`picture ${lateS ? "late" : ""}`}><canvas ref=${canvas} role="img" aria-label=${`Picture of ${topic}`} />
    <figcaption>${lateS ? `No picture for ${lateS} s: ${why}` : text || "Waiting for a picture"}</figcaption></figure>`;
}

/** The pictures that lie over the view. */
export function PictureOverlay() {
  const pictures = useStore((s) => s.pictures);
  const topics = useStore((s) => s.topics);
  return html`<div class="pictures">${pictures.map((topic) => html`<div class="overlay" key=${topic}>
    <header><span class="name" title=${topic}>${topic}</span>
      <${Button} icon="close" title=${`Close the picture of ${topic}`} onClick=${() => showPicture(topic, false)} /></header>
    ${isPicture(topics[topic]?.type) ? html`<${Picture} topic=${topic} type=${topics[topic].type} />` : html`<p class="empty">The topic is gone.</p>`}
  </div>`)}</div>`;
}

export function showPicture(topic, on) {
  const others = store.values.pictures.filter((one) => one !== topic);
  store.set({ pictures: on ? [...others.slice(-2), topic] : others });
}
