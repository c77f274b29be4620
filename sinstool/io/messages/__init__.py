"""Message definitions as byte layouts: columns from bytes, bytes from columns.

``definitions`` turns the text of a schema into fields, ``layout`` finds where each field of
a message lies, ``decode`` gathers columns from many messages at once and ``encode`` writes
them. Nothing here knows files, topics or what a column means.
"""
