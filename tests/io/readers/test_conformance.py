"""Every file of the MCAP format's conformance set, and what must be read from it."""

import pytest
from mcap.opcode import Opcode

from sinstool.io.readers import open_log
from sinstool.io.readers.mcap_file import OtherPlace
from tests.helpers.logs import Row, read_back
from tests.io.readers.conformance import built, variants

VARIANTS = {variant["name"]: variant for variant in variants()}


def test_there_are_all_of_them():
    assert len(VARIANTS) == 416


@pytest.mark.parametrize("salvage", [False, True], ids=["strict", "salvage"])
@pytest.mark.parametrize("name", VARIANTS)
def test_every_record_is_read(tmp_path, name, salvage):
    features, records = VARIANTS[name]["features"], VARIANTS[name]["records"]
    path = tmp_path / "a.mcap"
    path.write_bytes(built(features, records))
    by_kind = {
        kind: [r for r in records if r["type"] == kind]
        for kind in ("Schema", "Channel", "Message", "Attachment", "Metadata")
    }
    messages = [
        Row("example", int(r["logTime"]), int(r["publishTime"]), bytes(r["data"]))
        for r in by_kind["Message"]
    ]
    with open_log(path, salvage) as log:
        assert read_back(log) == messages
        assert [number for batch in log.batches() for number in batch.sequence.tolist()] == [
            r["sequence"] for r in by_kind["Message"]
        ]
        assert not log.lost
        schema = by_kind["Schema"][0] if by_kind["Schema"] else None
        assert [
            (c.id, c.topic, c.message_encoding, c.type_name, c.schema_encoding, c.schema_text)
            for c in log.channels.values()
        ] == [
            (
                r["id"],
                r["topic"],
                r["messageEncoding"],
                *(
                    (schema["name"], schema["encoding"], bytes(schema["data"]).decode())
                    if schema
                    else ("", "", "")
                ),
            )
            for r in by_kind["Channel"]
        ]
        assert [c.metadata for c in log.channels.values()] == [
            r["metadata"] for r in by_kind["Channel"]
        ]
        if log.counts:
            assert log.counts == {1: len(messages)}
        others = [p for p in log.places() if isinstance(p, OtherPlace)]
        for opcode, kind in ((Opcode.ATTACHMENT, "Attachment"), (Opcode.METADATA, "Metadata")):
            places = [p for p in others if p.opcode == opcode]
            assert len(places) == len(by_kind[kind])
            for place, record in zip(places, by_kind[kind], strict=True):
                assert record["name"].encode() in log.read_at(place.offset, place.length)
