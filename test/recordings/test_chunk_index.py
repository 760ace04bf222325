"""The index of a file's chunks, beside the MCAP library's reading of the same records."""

import struct
from dataclasses import fields

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.data_stream import RecordBuilder
from mcap.records import ChunkIndex as Record
from mcap.records import Statistics

from pendubot_identification.recordings.chunk_index import ChunkIndex, FoundChunk

times = st.integers(0, 2**64 - 1)
places = st.dictionaries(st.integers(0, 4), times, max_size=3)
records = st.builds(
    Record,
    chunk_length=times,
    chunk_start_offset=times,
    compression=st.sampled_from(['', 'lz4', 'zstd']),
    compressed_size=times,
    message_end_time=times,
    message_index_length=times,
    message_index_offsets=places,
    message_start_time=times,
    uncompressed_size=times,
)
bounds = st.one_of(st.integers(-(2**63), 2**65), times)


def written(*records):
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    return builder.end()


STATISTICS = Statistics(
    attachment_count=0,
    channel_count=1,
    channel_message_counts={1: 2},
    chunk_count=3,
    message_count=2,
    message_end_time=5,
    message_start_time=4,
    metadata_count=0,
    schema_count=1,
)


@given(st.lists(records, max_size=8), st.sets(st.integers(0, 4)), bounds, bounds)
def test_chunks_are_found_as_one_by_one(chunks, channels, low, high):
    index, others = ChunkIndex.split(written(*chunks[:3], STATISTICS, *chunks[3:]))
    assert others == written(STATISTICS)
    chunks = sorted(chunks, key=lambda chunk: chunk.chunk_start_offset)
    assert index.offset.tolist() == [chunk.chunk_start_offset for chunk in chunks]
    assert index.length.tolist() == [chunk.chunk_length for chunk in chunks]
    assert index.holding(channels, low, high).tolist() == [
        k
        for k, chunk in enumerate(chunks)
        if (not chunk.message_index_offsets or channels & chunk.message_index_offsets.keys())
        and low <= chunk.message_end_time
        and chunk.message_start_time < high
        and low < high
    ]


@given(st.lists(records.filter(lambda chunk: chunk.message_index_offsets), max_size=8))
def test_what_was_found_makes_the_index_that_would_have_been_written(chunks):
    chunks = sorted(chunks, key=lambda chunk: chunk.chunk_start_offset)
    found = ChunkIndex.of(
        [
            FoundChunk(
                chunk.message_start_time,
                chunk.message_end_time,
                chunk.chunk_start_offset,
                chunk.chunk_length,
                tuple(chunk.message_index_offsets),
            )
            for chunk in chunks
        ]
    )
    written_index, _ = ChunkIndex.split(written(*chunks))
    for field in fields(ChunkIndex):
        one, other = getattr(found, field.name), getattr(written_index, field.name)
        assert (one.dtype, one.tolist()) == (other.dtype, other.tolist()), field.name


@given(st.lists(records, min_size=1, max_size=3), st.data())
def test_cut_records_are_refused(chunks, data):
    whole = written(*chunks)
    ends = [len(written(*chunks[:k])) for k in range(len(chunks) + 1)]
    cut = data.draw(st.sampled_from([k for k in range(len(whole)) if k not in ends]))
    with pytest.raises((ValueError, struct.error)):
        ChunkIndex.split(whole[:cut])
