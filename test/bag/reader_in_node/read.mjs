// Prints every message of MCAP files as a line of JSON: {file, topic, logTime, sequence, message}.
// It reads with what Foxglove reads with. Numeric arrays are {bytes: <base64>}, little endian;
// integers of 64 bits are {integer: "…"}; numbers that JSON has no word for are {float: "NaN"}.
import { openSync, readSync, fstatSync } from "node:fs";
import { McapIndexedReader } from "@mcap/core";
import { parse } from "@foxglove/rosmsg";
import { MessageReader } from "@foxglove/rosmsg2-serialization";
import { decompress } from "fzstd";

function readable(path) {
  const file = openSync(path);
  return {
    size: async () => BigInt(fstatSync(file).size),
    read: async (offset, length) => {
      const data = new Uint8Array(Number(length));
      const count = readSync(file, data, 0, data.length, Number(offset));
      if (count !== data.length) {
        throw new Error(`${path}: expected ${length} bytes at ${offset}, got ${count}`);
      }
      return data;
    },
  };
}

function plain(key, value) {
  if (ArrayBuffer.isView(value)) {
    const bytes = Buffer.from(value.buffer, value.byteOffset, value.byteLength);
    return { bytes: bytes.toString("base64") };
  }
  if (typeof value === "bigint") {
    return { integer: value.toString() };
  }
  return typeof value === "number" && !Number.isFinite(value) ? { float: String(value) } : value;
}

for (const path of process.argv.slice(2)) {
  const reader = await McapIndexedReader.Initialize({
    readable: readable(path),
    decompressHandlers: { zstd: (data, size) => decompress(data, new Uint8Array(Number(size))) },
  });
  const decoders = new Map();
  for (const { id, schemaId } of reader.channelsById.values()) {
    const schema = reader.schemasById.get(schemaId);
    const definition = parse(new TextDecoder().decode(schema.data), { ros2: true });
    decoders.set(id, new MessageReader(definition));
  }
  for await (const { channelId, logTime, sequence, data } of reader.readMessages()) {
    const { topic } = reader.channelsById.get(channelId);
    const message = decoders.get(channelId).readMessage(data);
    const line = { file: path, topic, logTime: logTime.toString(), sequence, message };
    if (!process.stdout.write(JSON.stringify(line, plain) + "\n")) {
      await new Promise((resolve) => process.stdout.once("drain", resolve));
    }
  }
}
