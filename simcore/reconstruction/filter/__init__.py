"""From detector signal to what is back-projected: line integrals, edges of breast and detector, the filter."""
