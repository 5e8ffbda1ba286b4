// Foxglove's own client library and a protobuf reader against a studio with a live station.
// node check.mjs http://127.0.0.1:8080 [SECONDS]
import protocol from "@foxglove/ws-protocol";
import protobuf from "protobufjs";
import descriptor from "protobufjs/ext/descriptor/index.js";
import WebSocket from "ws";

const { FoxgloveClient } = protocol;
const [studio, seconds = "5"] = process.argv.slice(2);
if (!studio) {
  console.error("usage: node check.mjs http://127.0.0.1:8080 [SECONDS]");
  process.exit(2);
}
const url = `${studio.replace(/^http/, "ws").replace(/\/$/, "")}/api/v1/foxglove`;

function fail(problem) {
  console.error(`failed: ${problem}`);
  process.exit(1);
}

function typeOf(channel) {
  const set = descriptor.FileDescriptorSet.decode(Buffer.from(channel.schema, "base64"));
  return protobuf.Root.fromDescriptor(set).lookupType(channel.schemaName);
}

async function watch(subprotocol) {
  const client = new FoxgloveClient({ ws: new WebSocket(url, [subprotocol]) });
  const seen = new Map();
  const subscribed = new Map();
  let info;
  client.on("error", (error) => fail(`${subprotocol}: ${error.message}`));
  client.on("status", (status) => console.log("status:", status.message));
  client.on("serverInfo", (event) => (info = event));
  client.on("advertise", (channels) => {
    for (const channel of channels) {
      if (channel.encoding !== "protobuf" || channel.schemaEncoding !== "protobuf") {
        fail(`${channel.topic} is in ${channel.encoding}`);
      }
      subscribed.set(client.subscribe(channel.id), { channel, type: typeOf(channel) });
    }
  });
  client.on("message", ({ subscriptionId, timestamp, data }) => {
    const { channel, type } = subscribed.get(subscriptionId) ?? fail(`a message of no subscription`);
    const message = type.decode(new Uint8Array(data.buffer, data.byteOffset, data.byteLength));
    const entry = seen.get(channel.topic) ?? { count: 0, last: 0n };
    if (timestamp < entry.last) {
      fail(`${channel.topic} goes back in time`);
    }
    seen.set(channel.topic, { count: entry.count + 1, last: timestamp, message });
  });
  await new Promise((resolve) => setTimeout(resolve, 1000 * Number(seconds)));
  client.close();
  if (!info?.name.startsWith("palpate")) {
    fail("no serverInfo");
  }
  const topics = [...subscribed.values()].map(({ channel }) => channel.topic);
  for (const topic of topics) {
    // Nothing is commanded, and nothing may have happened.
    const { count, message, last } = seen.get(topic) ?? { count: 0 };
    console.log(`${subprotocol} ${topic}: ${count} messages`);
    if (!["/joint_commands", "/log"].includes(topic) && count < 2) {
      fail(`${topic} has ${count} messages`);
    }
    const age = last === undefined ? 0 : Date.now() - Number(last / 1000000n);
    if (Math.abs(age) > 5000 && topic !== "/joint_commands" && topic !== "/log") {
      fail(`the newest message of ${topic} is ${age} ms old`);
    }
    if (topic === "/joint_states" && !message.joints.every(({ name, position }) => name && Number.isFinite(position))) {
      fail("a joint without name or position");
    }
    if (topic === "/tf" && !message.transforms.every((frame) => frame.parent_frame_id && frame.child_frame_id)) {
      fail("a transform without frames");
    }
    if (topic.startsWith("/tactile/") && message.active.length !== message.raw.length) {
      fail(`${topic}: ${message.active.length} activations, ${message.raw.length} readings`);
    }
  }
}

await watch("foxglove.sdk.v1");
await watch("foxglove.websocket.v1");
console.log("ok");
