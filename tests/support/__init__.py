"""What tests and benches share: waiting, ports, services and their stand-ins, programs, files."""
