"""General tools without mechanics, for all packages: errors, text, files, units, plain data, strict models, logs."""
