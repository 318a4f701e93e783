"""Tables of measured values in text, under any headings."""
