"""Message definitions as byte layouts: columns from bytes, bytes from columns.

``definitions`` parses the text of a schema, ``layout`` finds the offset of each field in a message,
``decode`` gathers columns from many messages at once, and ``encode`` writes them. Nothing here
depends on files, topics or the meaning of a column.
"""
