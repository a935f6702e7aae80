"""General tools without mechanics, for all rooms: errors, text, files, units, plain data, strict models, logs."""
