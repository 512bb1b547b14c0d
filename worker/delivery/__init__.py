"""Sending cases to archives and workstations by C-STORE.

addresses    which hosts are allowed, the address of a name
association  an association on pynetdicom: opened, tested, instances stored
overrides    what is replaced inside of pynetdicom
outcomes     what each answer of a peer means, with advice
files        what a file is; decompressing it
sender       one delivery from claim to end
tour         one attempt at all that is missing of it
commitment   storage commitment
echo         testing a destination
app          the Celery worker of the queue ``delivery``
"""
