"""What every room may use and what knows no mechanics: errors, text, files, units, plain data, strict models, logs."""
