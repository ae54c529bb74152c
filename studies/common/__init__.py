"""What the studies share: their options, records, tables, drawings and problems."""
