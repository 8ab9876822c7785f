// Instantiates the headers of kernels/runtime; see native_headers.cpp.
#include "pool.h"

struct Bounds {
    unsigned shape[1];
    unsigned long size;
};

using namespace wrt;

void pools(pool::Board& board, const pool::Job* job)
{
    pool::serve<Bounds>(board, 3);
    pool::lead<Bounds>(board, board.slots[2], job);
    pool::stop(board.slots[2]);
    pool::close(board);
}

int calls(Way* stages, const Call* steps, const int* counts, int* totals)
{
    run_stages<Bounds, 3, 8192, 32>(stages, 0, 2, counts, 4096, 5);
    return collapse_steps<Bounds>(steps, totals, totals + 2);
}
