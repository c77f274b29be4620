"""Limits on declared sizes, on reads and on memory that all formats share.

They are plain numbers, as compiled searches take them in too.
"""

from __future__ import annotations

# Blocks and single records, packed or not, are taken up to this size without a question: recorders
# use chunks of about 1 MiB. Of a damaged block no more than this is unpacked.
ORDINARY_BLOCK = 256 * 2**20
# Larger ones, of point clouds and maps, are taken where there is memory for them; see
# `sinstool.io.readers.compression.too_large`. What is beyond this is refused.
MAX_BLOCK = 2**31 - 1
# A record of an MCAP other than a chunk or an attachment that claims more than this is damage.
MAX_RECORD = 64 * 2**20
# An index at the end of a file that is larger is not read: the records themselves tell the same.
MAX_INDEX = 256 * 2**20
# Definitions of channels beyond this number are not looked at. Identifiers of an MCAP have 16
# bits; a log that defines more than all of them over and over is no log.
MAX_DEFINITIONS = 2**18
# More damaged places than this, of a file or in one chunk, are not worked through.
MAX_PLACES = 4096
# Bytes of a file that are looked through at once
WINDOW = 4 * 2**20
# So many messages make a batch at most.
ROWS = 2**18
# Chunks larger than this are not read ahead.
LARGE = 32 * 2**20
