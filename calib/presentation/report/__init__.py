"""The report: one document of plain data, told as HTML, as Markdown and on the terminal."""
