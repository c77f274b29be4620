// Writes MCAP files of chosen features with @mcap/core's builders: the conformance set of the
// format is such files, one chunk at most, its records in the order given.
//
//   node conformance.mjs FOLDER < variants.json     (with @mcap/core installed where it lies)
//
// A variant: {name, features: [...], records: [...]}; bytes are lists of numbers, times strings.

import { readFileSync, writeFileSync } from "node:fs";
import { crc32 } from "@foxglove/crc";
import { McapChunkBuilder, McapRecordBuilder, Opcode } from "@mcap/core";

const DATA = new Set(["Schema", "Channel", "Message"]);

function revived(record) {
  const out = { ...record };
  for (const key of ["logTime", "publishTime", "createTime"]) {
    if (key in out) out[key] = BigInt(out[key]);
  }
  if ("data" in out) out.data = Uint8Array.from(out.data);
  if ("metadata" in out) out.metadata = new Map(Object.entries(out.metadata));
  return out;
}

function written(features, records) {
  const has = (feature) => features.includes(feature);
  const file = new McapRecordBuilder({ padRecords: has("pad") });
  file.writeMagic();
  file.writeHeader({ profile: "", library: "" });

  const chunk = has("ch") ? new McapChunkBuilder({ useMessageIndex: has("mx") }) : undefined;
  const attachments = [];
  const metadata = [];
  const messages = records.filter((record) => record.type === "Message");
  const ofType = (type) => records.filter((record) => record.type === type);
  for (const record of records) {
    const offset = BigInt(file.length);
    if (DATA.has(record.type)) {
      const add = chunk ? `add${record.type}` : `write${record.type}`;
      (chunk ?? file)[add](record);
    } else if (record.type === "Attachment") {
      const length = file.writeAttachment(record);
      attachments.push({ ...record, offset, length, dataSize: BigInt(record.data.length) });
    } else {
      metadata.push({ name: record.name, offset, length: file.writeMetadata(record) });
    }
  }

  const chunkIndexes = [];
  if (chunk) {
    const body = chunk.buffer;
    const times = {
      compression: "",
      messageStartTime: chunk.messageStartTime,
      messageEndTime: chunk.messageEndTime,
      uncompressedSize: BigInt(body.length),
    };
    const chunkStartOffset = BigInt(file.length);
    const chunkLength = file.writeChunk({ ...times, uncompressedCrc: crc32(body), records: body });
    const messageIndexOffsets = new Map();
    const indexStart = BigInt(file.length);
    for (const index of chunk.indices) {
      messageIndexOffsets.set(index.channelId, BigInt(file.length));
      file.writeMessageIndex(index);
    }
    const messageIndexLength = BigInt(file.length) - indexStart;
    const compressedSize = BigInt(body.length);
    chunkIndexes.push({
      ...times,
      compressedSize,
      chunkStartOffset,
      chunkLength,
      messageIndexLength,
      messageIndexOffsets,
    });
  }
  file.writeDataEnd({ dataSectionCrc: crc32(file.buffer) });

  const start = BigInt(file.length);
  const groups = [];
  const group = (groupOpcode, wanted, items, write) => {
    const groupStart = BigInt(file.length);
    if (wanted) items.forEach(write);
    const groupLength = BigInt(file.length) - groupStart;
    if (groupLength > 0n) groups.push({ groupOpcode, groupStart, groupLength });
  };
  const counts = new Map();
  for (const { channelId } of messages) {
    counts.set(channelId, (counts.get(channelId) ?? 0n) + 1n);
  }
  const logTimes = messages.map((message) => message.logTime).sort((a, b) => Number(a - b));
  const statistics = {
    messageCount: BigInt(messages.length),
    schemaCount: ofType("Schema").length,
    channelCount: ofType("Channel").length,
    attachmentCount: attachments.length,
    metadataCount: metadata.length,
    chunkCount: chunk ? 1 : 0,
    messageStartTime: logTimes[0] ?? 0n,
    messageEndTime: logTimes.at(-1) ?? 0n,
    channelMessageCounts: counts,
  };
  group(Opcode.SCHEMA, has("rsh"), ofType("Schema"), (r) => file.writeSchema(r));
  group(Opcode.CHANNEL, has("rch"), ofType("Channel"), (r) => file.writeChannel(r));
  group(Opcode.STATISTICS, has("st"), [statistics], (r) => file.writeStatistics(r));
  group(Opcode.METADATA_INDEX, has("mdx"), metadata, (r) => file.writeMetadataIndex(r));
  group(Opcode.ATTACHMENT_INDEX, has("ax"), attachments, (r) => file.writeAttachmentIndex(r));
  group(Opcode.CHUNK_INDEX, has("chx"), chunkIndexes, (r) => file.writeChunkIndex(r));
  const summaryStart = groups.length > 0 ? start : 0n;
  let summaryOffsetStart = 0n;
  if (has("sum")) {
    summaryOffsetStart = BigInt(file.length);
    groups.forEach((g) => file.writeSummaryOffset(g));
  }

  // The CRC covers the summary and the footer as far as the CRC itself.
  const summary = file.buffer.slice(Number(start));
  const covered = new Uint8Array(summary.length + 25);
  covered.set(summary);
  const footer = new DataView(covered.buffer, summary.length);
  footer.setUint8(0, Opcode.FOOTER);
  footer.setBigUint64(1, 20n, true);
  footer.setBigUint64(9, summaryStart, true);
  footer.setBigUint64(17, summaryOffsetStart, true);
  file.writeFooter({ summaryStart, summaryOffsetStart, summaryCrc: crc32(covered) });
  file.writeMagic();
  return file.buffer;
}

for (const { name, features, records } of JSON.parse(readFileSync(0, "utf8"))) {
  writeFileSync(`${process.argv[2]}/${name}.mcap`, written(features, records.map(revived)));
}
