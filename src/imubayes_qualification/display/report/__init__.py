"""The uncertainty report as a document: one content, written as an HTML page and as a PDF file."""
