"""Sending cases to archives and workstations by C-STORE.

addresses    which hosts are allowed, the address of a name
association  an association on pynetdicom: opened, tested, instances stored
outcomes     what each answer of a peer means, with advice
files        what a file is; decompressing it
courier      one delivery from claim to end
app          the Celery worker of the queue ``delivery``
"""
