// Foxglove's own client: prints as JSON what it sees and does. Arguments: address, URI of a mesh.
import protocol from "@foxglove/ws-protocol";
import WebSocket from "ws";

const { FoxgloveClient } = protocol;
const [address, mesh] = process.argv.slice(2);
const client = new FoxgloveClient({ ws: new WebSocket(address, [FoxgloveClient.SUPPORTED_SUBPROTOCOL]) });
const channels = new Map();
const services = new Map();
const values = new Map();
const seen = {};

client.on("error", (error) => fail(`error: ${error}`));
client.on("close", () => fail("the gateway has closed the connection"));
client.on("advertise", (all) => all.forEach((channel) => channels.set(channel.topic, channel)));
client.on("advertiseServices", (all) => all.forEach((service) => services.set(service.name, service)));

function fail(text) {
  console.error(text);
  process.exit(1);
}

function event(name, fits = () => true) {
  return new Promise((resolve) => {
    const listener = (value) => {
      if (fits(value)) {
        client.off(name, listener);
        resolve(value);
      }
    };
    client.on(name, listener);
  });
}

async function until(condition) {
  while (!condition()) {
    await new Promise((resolve) => setTimeout(resolve, 20));
  }
}

const [info, time] = await Promise.all([event("serverInfo"), event("time")]);
seen.capabilities = info.capabilities;
seen.time = Number(time.timestamp);
await until(() => channels.has("/slider/joint_states") && services.has("/slider/controller_manager/list_controllers"));
seen.channel = channels.get("/slider/joint_states");
seen.service = services.get("/slider/controller_manager/list_controllers");

const subscription = client.subscribe(seen.channel.id);
const message = await event("message", (one) => one.subscriptionId === subscription);
seen.message = Buffer.from(message.data.buffer, message.data.byteOffset, message.data.byteLength).toString("base64");

const command = client.advertise({
  topic: "/slider/joint1_position_controller/command",
  encoding: "json",
  schemaName: "std_msgs/Float64",
});
client.sendMessage(command, new TextEncoder().encode(JSON.stringify({ data: 0.25 })));

const answered = event("serviceCallResponse", (one) => one.callId === 7);
client.sendServiceCallRequest({ serviceId: seen.service.id, callId: 7, encoding: "json", data: new Uint8Array() });
seen.answer = JSON.parse(new TextDecoder().decode((await answered).data));

const failed = event("serviceCallFailure", (one) => one.callId === 8);
client.sendServiceCallRequest({ serviceId: 4000000, callId: 8, encoding: "json", data: new Uint8Array() });
seen.failure = (await failed).message;

const gain = "/slider/joint1_position_controller/pid/p";
client.on("parameterValues", (all) => all.parameters.forEach((one) => values.set(one.name, one)));
client.getParameters([gain], "get");
await until(() => values.has(gain));
seen.before = values.get(gain);
client.subscribeParameterUpdates([gain]);
client.setParameters([{ name: gain, value: 90, type: "float64" }]);
await until(() => values.get(gain).value === 90);
seen.after = values.get(gain);

const connected = event("connectionGraphUpdate");
client.subscribeConnectionGraph();
seen.graph = await connected;

for (const [name, uri] of [["asset", mesh], ["noAsset", "file:///etc/passwd"]]) {
  const fetched = event("fetchAssetResponse");
  client.fetchAsset(uri, 1);
  const { status, error, data } = await fetched;
  seen[name] = { status, error, size: data?.byteLength };
}

console.log(JSON.stringify(seen));
process.exit(0);
