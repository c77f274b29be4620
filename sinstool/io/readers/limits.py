"""Limits on declared sizes, on reads and on memory that all formats share.

They are plain numbers, so that compiled searches can use them too.
"""

from __future__ import annotations

# Blocks and single records, compressed or not, are always accepted up to this size: recorders use
# chunks of about 1 MiB. Of a damaged block no more than this is unpacked.
ORDINARY_BLOCK = 256 * 2**20
# Larger ones, of point clouds and maps, are accepted up to this where there is memory for them; see
# `sinstool.io.readers.compression.too_large`.
MAX_BLOCK = 2**31 - 1
# A record of an MCAP other than a chunk or an attachment that claims more than this is damage.
MAX_RECORD = 64 * 2**20
# A larger index at the end of a file is not read, as the records hold the same information.
MAX_INDEX = 256 * 2**20
# Definitions of channels beyond this number are ignored. Identifiers of an MCAP have 16 bits, so
# that a real log stays far below it.
MAX_DEFINITIONS = 2**18
# Most damaged places of a file, or of one chunk, that are worked through
MAX_PLACES = 4096
# Bytes of a file that are searched at a time
WINDOW = 4 * 2**20
# Most messages in a batch
ROWS = 2**18
# Chunks larger than this are not read ahead.
LARGE = 32 * 2**20
