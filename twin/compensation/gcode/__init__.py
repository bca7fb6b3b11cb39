"""Part programs in G-code (ISO 6983, RS-274/NGC) with the corrections of a compensation table written into them.

For controllers without compensation tables. Lines of text in, lines of text out; nothing else is changed.
"""
