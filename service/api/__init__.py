"""HTTP endpoints: they translate the wire to the core and back and hold no numerics."""
