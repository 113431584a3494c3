"""Effects by the path under which the diagnosis knew them; they are described in `hallsym.model.effect`."""

from hallsym.model import Effect, Facts, Variant

__all__ = ["Effect", "Facts", "Variant"]
