"""One YAML file as a frozen value: schema, loading, checks, mismatch and where it acts."""
