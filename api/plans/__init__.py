"""Plans: how they are requested, solved in worker processes, stored and exported.

    plan_book, plan_records, plan_store    plans as resources: submit, wait, cancel; their rows in the database
    solver                       lanes of worker processes (flight, requests, ahead), with deadlines and bounded queues
    worker, solving              what runs in a worker process
    dask_link, dask_lane, dask_work    solves in a Dask cluster, with our own workers as the fallback
    jobs, job_board, liveness    what service and workers share: jobs, progress and stop flags, heartbeats
    contingencies                plans made ahead of a loss
    explanations                 why a plan is as it is, previews, robustness: solved, kept in memory, never stored
    mission_files, certificate   exports, and the proof of `skyfolio bound`

It may import `common` and `store`. The service's process never imports `solving`, a worker never a web framework, a
database or MAVLink: a test looks. Whatever a worker shares may be left half-written by a kill, so nothing in shared
memory is locked.
"""
