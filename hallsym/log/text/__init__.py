"""Tables of text as laboratories write them: their form is recognised, then pyarrow streams them.

- `cells`: numbers with a decimal point or comma, missing values, names with their unit (`x_ref [µm]`).
- `sniff`: bytes in any of the usual codings become UTF-8; what a file is, in one record and one line.
"""
