// Reads MCAP files with @mcap/core, CRCs checked: by their index, and as a stream. Prints a line
// of JSON for each file: messages by topic both ways, and whether log times of the first ascend.
//
//   node read_all.mjs FILE...     (with @mcap/core and @mcap/support installed where it lies)

import { closeSync, fstatSync, openSync, readSync } from "node:fs";
import { McapIndexedReader, McapStreamReader } from "@mcap/core";
import { loadDecompressHandlers } from "@mcap/support";

const decompressHandlers = await loadDecompressHandlers();

function readable(fd) {
  return {
    size: async () => BigInt(fstatSync(fd).size),
    read: async (offset, size) => {
      const bytes = new Uint8Array(Number(size));
      readSync(fd, bytes, 0, bytes.length, Number(offset));
      return bytes;
    },
  };
}

function count(counts, topic) {
  counts[topic] = (counts[topic] ?? 0) + 1;
}

async function indexed(fd) {
  const reader = await McapIndexedReader.Initialize({
    readable: readable(fd),
    decompressHandlers,
  });
  const counts = {};
  let last = 0n;
  let ascending = true;
  for await (const message of reader.readMessages({ validateCrcs: true })) {
    count(counts, reader.channelsById.get(message.channelId).topic);
    ascending &&= message.logTime >= last;
    last = message.logTime;
  }
  return { counts, ascending, declared: Number(reader.statistics.messageCount) };
}

function streamed(fd) {
  const reader = new McapStreamReader({ decompressHandlers, validateCrcs: true });
  const counts = {};
  const topics = new Map();
  const bytes = new Uint8Array(2 ** 20);
  let headers = 0;
  for (let size; (size = readSync(fd, bytes, 0, bytes.length, null)) > 0; ) {
    reader.append(bytes.slice(0, size));
    for (let record; (record = reader.nextRecord()); ) {
      if (record.type === "Header") {
        headers += 1;
      } else if (record.type === "Channel") {
        topics.set(record.id, record.topic);
      } else if (record.type === "Message") {
        count(counts, topics.get(record.channelId));
      }
    }
  }
  return { counts, headers, done: reader.done() };
}

for (const path of process.argv.slice(2)) {
  const fd = openSync(path);
  console.log(JSON.stringify({ indexed: await indexed(fd), streamed: streamed(fd) }));
  closeSync(fd);
}
