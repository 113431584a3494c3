"""Tables of text as laboratories write them: what they are is recognised, then pyarrow streams them.

- `encoding`: bytes, compressed or not, in any of the usual codings, become UTF-8 in pieces.
- `units`: a name of a column with its unit (`x_ref [µm]`), and rows of units.
- `numbers`: decimal point or comma, separators of thousands, missing values.
- `rows`: lines split into cells; where the table begins.
- `sniff`: all of it together: what a file is, in one record and one line (`dialect`).
- `times`: dates and times of day as seconds.
- `stream`: the lines of the table alone, as pyarrow reads them.
"""

from hallsym.log.text.encoding import Encoded, end_of
from hallsym.log.text.numbers import MISSING, as_float
from hallsym.log.text.sniff import Dialect, sniffed, stated_delimiter
from hallsym.log.text.stream import Cleaner, TableStream
from hallsym.log.text.times import Seconds

__all__ = [
    "MISSING",
    "Cleaner",
    "Dialect",
    "Encoded",
    "Seconds",
    "TableStream",
    "as_float",
    "end_of",
    "sniffed",
    "stated_delimiter",
]
