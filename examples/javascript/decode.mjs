// The payloads of docs/protocol.md in another language: no Zenoh here, only what travels over it.
//
//   node decode.mjs FRAMES SCHEMAS ESTIMATE
//
// FRAMES    one message after another, each a msgpack map {signal, payload}, as a recorder of your own might keep them
// SCHEMAS   the folder docs/schemas
// ESTIMATE  a file that is written: one estimate, stamped with the time since 1970
//
// Every payload is decoded and held against the schema of its message. Prints a line for each, and ends with 1 where one
// is not what its schema says.

import { readFileSync, writeFileSync } from "node:fs";
import { decode, decodeMulti, encode } from "@msgpack/msgpack";

const [frames, schemas, estimate] = process.argv.slice(2);

// Whole numbers of 64 bits come as BigInt: nanoseconds since 1970 do not fit into a number.
const OPTIONS = { useBigInt64: true };

function typeOf(value) {
  if (value === null) return "null";
  if (Array.isArray(value)) return "array";
  if (typeof value === "bigint" || Number.isInteger(value)) return "integer";
  return typeof value; // "number", "string", "boolean", "object"
}

// What of `value` breaks `schema`: the few keywords of JSON Schema that the schemas use.
function problems(value, schema, at) {
  if (schema.anyOf) {
    const found = schema.anyOf.map((one) => problems(value, one, at));
    return found.some((list) => list.length === 0) ? [] : found.flat();
  }
  const type = typeOf(value);
  const allowed = [schema.type].flat();
  if (!allowed.includes(type) && !(type === "integer" && allowed.includes("number"))) {
    return [`${at}: ${type}, not ${allowed}`];
  }
  if (schema.enum && !schema.enum.includes(value)) return [`${at}: ${value} is none of ${schema.enum}`];
  if (value < schema.minimum || value > schema.maximum) return [`${at}: ${value} is out of bounds`];
  if (type === "array") {
    if (value.length < (schema.minItems ?? 0) || value.length > (schema.maxItems ?? Infinity)) {
      return [`${at}: ${value.length} items`];
    }
    return value.flatMap((item, i) => problems(item, schema.items, `${at}[${i}]`));
  }
  if (type !== "object") return [];
  const missing = (schema.required ?? []).filter((name) => !(name in value)).map((name) => `${at}.${name} is missing`);
  return missing.concat(Object.entries(value).flatMap(([name, item]) => fieldProblems(name, item, schema, at)));
}

function fieldProblems(name, item, schema, at) {
  const patterns = Object.entries(schema.patternProperties ?? {});
  const fitting = patterns.filter(([pattern]) => new RegExp(pattern).test(name)).map(([, found]) => found);
  const found = schema.properties?.[name] ?? fitting[0] ?? schema.additionalProperties;
  return found ? problems(item, found, `${at}.${name}`) : [`${at}.${name} is unknown`];
}

let wrong = 0;
for (const { signal, payload } of decodeMulti(readFileSync(frames))) {
  const schema = JSON.parse(readFileSync(`${schemas}/${signal}.json`, "utf8"));
  const message = decode(payload, OPTIONS);
  const found = problems(message, schema, signal);
  wrong += found.length;
  console.log(`${signal} ${Object.keys(message).length} fields, ${found.length ? found.join("; ") : "as its schema says"}`);
}

// BigInt wherever a whole number may be beyond 32 bits: others that large would travel as fractions, and be refused.
const message = {
  epoch: BigInt(Math.floor(Math.random() * 2 ** 48)),
  sequence: 0,
  t_ns: BigInt(Date.now()) * 1_000_000n,
  north_m: 1.5,
  east_m: -2,
  heading_rad: Math.PI / 2,
  yaw_rate_radps: 0,
  velocity_north_mps: 0.1,
  velocity_east_mps: 0,
  depth_m: 12.25,
};
writeFileSync(estimate, encode(message, OPTIONS));
process.exit(wrong ? 1 : 0);
