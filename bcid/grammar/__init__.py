"""Beyond the catalogue: a grammar of terms, searched for the one that explains what no known effect does."""
