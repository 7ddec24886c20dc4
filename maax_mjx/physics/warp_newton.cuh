// The body of one thread of `warp_newton`: Newton's method on the constraint forces of one world, by the LANES threads of
// a block. It follows MJX-Warp's solver step by step: the same costs, line search and criteria to stop.
//
// All of a world's data live in shared memory. Degrees of freedom are taken in blocks of four, and the blocks that a row
// of the Jacobian, of the inertia or of the Hessian's factor has are bits of a set: what is zero costs nothing. Rows are
// sorted into groups that have the same blocks, as those of all contacts of a box with floor and walls have.
//
// The caller defines NV, CAPACITY, ROWS, ENTRIES, GROUPS, BLOCKS, BYTES, IS_LAST, SPARSE, STRIDE, FRICTIONS, WARMSTART,
// ITERATIONS, LS_ITERATIONS, the bits NO_ITERATIONS_LEFT and NO_LS_ITERATIONS_LEFT, and the states SATISFIED, QUADRATIC,
// LINEARNEG and LINEARPOS. A world with more than ROWS rows, ENTRIES blocks in them or BLOCKS blocks of the factor is noted in
// `left`; with IS_LAST there is none.

typedef unsigned Set;

#if defined(__CUDA_ARCH__)
#define LANES 32
#define SYNC() __syncwarp()
#define COUNT(set) __popc(set)
#define FIRST(set) (__ffs(set) - 1)
// Two units in the last place are enough, and spare calls.
#define INVERSE_ROOT(x) rsqrtf(x)
#define ROOT(x) ((x) > 0.0f ? (x) * rsqrtf(x) : 0.0f)
#define QUOTIENT(x, y) __fdividef(x, y)
#else
#define LANES 1
#define SYNC()
#define COUNT(set) __builtin_popcount(set)
#define FIRST(set) __builtin_ctz(set)
#define INVERSE_ROOT(x) (1.0f / sqrtf(x))
#define ROOT(x) sqrtf(x)
#define QUOTIENT(x, y) ((x) / (y))
#endif
#define N_BLOCKS ((NV + 3) / 4)
#define PADDED (4 * N_BLOCKS)
#define BELOW(i) ((Set(1) << (i)) - 1)
#define HAS(set, i) ((set) >> (i) & 1)
// Loops stay loops: worlds are at different places of the code, and all of a multiprocessor share one instruction cache.
#define ROLLED _Pragma("unroll 1")
#define EACH(i, n) ROLLED for (int i = lane; i < (n); i += LANES)
#define EACH_IN(i, set) ROLLED for (Set rest_##i = (set), i = 0; rest_##i && (i = FIRST(rest_##i), true); rest_##i &= rest_##i - 1)

const float TINY = 1e-15f;
// Rounding of sums, in units of their terms; MJX-Warp allows for so much, too.
const float NOISE = 8.0f * 1.1920929e-07f;
// What a pivot of an inertia that couples blocks is at least, in units of its diagonal.
const float LEAST_PIVOT = 1e-6f;
// Kinds of rows.
const unsigned char EQUALITY = 0, FRICTION = 1, ONE_SIDED = 2;

struct alignas(16) Four {
    float x[4];
};
struct Block {
    Four row[4];
    // Keeps blocks that are read at the same time in different banks.
    Four unused;
};
struct World {
    Block hessian[BLOCKS];
    Four inertia[PADDED], entry[ENTRIES];
    Four qacc[N_BLOCKS], ma[N_BLOCKS], smooth[N_BLOCKS], grad[N_BLOCKS], half[N_BLOCKS], search[N_BLOCKS], mv[N_BLOCKS];
    // Pivots of the inertia alone: those of the Hessian are as large, since rows only add to it, unless rounding took it.
    float least_pivot[PADDED], inverse_pivot[PADDED];
    // Of rows; `curvature` is the stiffness of those whose cost is quadratic, and nothing for others.
    float jaref[ROWS], stiffness[ROWS], curvature[ROWS], force[ROWS];
    union {
        float jv[ROWS];
        // Until rows are sorted: the blocks of each, and where it goes.
        struct {
            unsigned short blocks[ROWS];
            short place[ROWS];
        } unsorted;
    };
    short origin[ROWS], group[ROWS];
    unsigned char state[ROWS], kind[ROWS];
    // Of groups: blocks, first row, and its first entry.
    unsigned short in_group[GROUPS];
    short first_row[GROUPS + 1], first_entry[GROUPS];
    Set below[N_BLOCKS], above[N_BLOCKS];
    // Of blocks; `own` is the group of the rows that have this block alone, or less than nothing.
    int level[N_BLOCKS], first_block[N_BLOCKS + 1], own[N_BLOCKS];
};
static_assert(sizeof(World) <= BYTES, "Room.bytes is too little");
#if defined(__CUDA_ARCH__)
extern __shared__ char dynamic_smem_base[];
World& w = *reinterpret_cast<World*>(dynamic_smem_base);
#else
World w;
#endif
float *const qacc = w.qacc->x, *const ma = w.ma->x, *const smooth = w.smooth->x, *const grad = w.grad->x;
float *const search = w.search->x, *const mv = w.mv->x;
float *const jaref = w.jaref, *const jv = w.jv, *const force = w.force;
const float *const stiffness = w.stiffness;

// Sets each to its sum over the lanes.
auto sum = [](auto&... x) {
#if defined(__CUDA_ARCH__)
    ROLLED for (int step = 16; step; step /= 2)
        ((x += __shfl_xor_sync(0xffffffffu, x, step)), ...);
#endif
};
auto in_any = [](Set x) {
#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ >= 800
    return __reduce_or_sync(0xffffffffu, x);
#else
#if defined(__CUDA_ARCH__)
    ROLLED for (int step = 16; step; step /= 2)
        x |= __shfl_xor_sync(0xffffffffu, x, step);
#endif
    return x;
#endif
};
// The lanes for which something is so, as bits.
auto lanes_with = [](bool is_so) {
#if defined(__CUDA_ARCH__)
    return __ballot_sync(0xffffffffu, is_so);
#else
    return Set(is_so);
#endif
};

int n = n_rows < CAPACITY ? n_rows : CAPACITY;
#if !IS_LAST
auto leave = [&]() {
    if (lane == 0)
        left[wp::atomic_add(n_left, 0, 1)] = world;
};
if (n > ROWS) {
    leave();
    return;
}
#endif

#if SPARSE
// Where the entries of a row lie, read while those of the row before it are.
struct Place {
    int begin, length;
};
auto place_of = [&](int r) { return r < n ? Place{row_address[r], row_length[r]} : Place{}; };
Place next = place_of(lane);
#else
// Four entries of a row, those of a block.
auto load = [&](int r, int b) {
    Four x{};
#if STRIDE % 4 == 0
    x = *reinterpret_cast<const Four*>(&J[r * STRIDE + 4 * b]);
    for (int c = 0; c < 4; c++)
        x.x[c] = 4 * b + c < NV ? x.x[c] : 0.0f;
#else
    for (int c = 0; c < 4; c++)
        x.x[c] = 4 * b + c < NV ? J[r * STRIDE + 4 * b + c] : 0.0f;
#endif
    return x;
};
#endif

// Which blocks each row has.
EACH(r, n) {
    Set blocks = 0;
#if SPARSE
    const Place now = next;
    next = place_of(r + LANES);
    // Rows that found no room in the Jacobian, which counts as an overflow, are empty.
    if (now.begin + now.length <= STRIDE)
        ROLLED for (int k = 0; k < now.length; k++)
            blocks |= Set(1) << (columns_of_rows[now.begin + k] >> 2);
#else
    for (int b = 0; b < N_BLOCKS; b++) {
        const Four x = load(r, b);
        if (x.x[0] != 0.0f || x.x[1] != 0.0f || x.x[2] != 0.0f || x.x[3] != 0.0f)
            blocks |= Set(1) << b;
    }
#endif
    w.unsorted.blocks[r] = blocks;
    w.unsorted.place[r] = -1;
}
EACH(i, PADDED)
    w.inertia[i] = Four{};
EACH(b, N_BLOCKS)
    w.below[b] = 0, w.level[b] = 0, w.own[b] = -1;
SYNC();

// Groups of rows with the same blocks: their rows lie together, from `first_row` of the group to that of the next.
int n_groups = 0, n_placed = 0, n_entries = 0;
ROLLED for (int start = 0; start < n; start += LANES) {
    Set rest = lanes_with(start + lane < n && w.unsorted.place[start + lane < n ? start + lane : 0] < 0);
    while (rest) {
        const Set blocks = w.unsorted.blocks[start + FIRST(rest)];
        const int begin = n_placed;
#if !IS_LAST
        if (n_groups == GROUPS) {
            leave();
            return;
        }
#endif
        ROLLED for (int other = start; other < n; other += LANES) {
            const int r = other + lane;
            const bool is_in = r < n && w.unsorted.blocks[r] == blocks;
            const Set found = lanes_with(is_in);
            if (is_in) {
                const int p = n_placed + COUNT(found & BELOW(lane));
                w.unsorted.place[r] = p, w.origin[p] = r, w.group[p] = n_groups;
            }
            n_placed += COUNT(found);
            if (other == start)
                rest &= ~found;
        }
        if (lane == 0)
            w.in_group[n_groups] = blocks, w.first_row[n_groups] = begin, w.first_entry[n_groups] = n_entries;
        EACH(b, N_BLOCKS)
            if (HAS(blocks, b)) {
                w.below[b] |= blocks & BELOW(b);
                if (blocks == Set(1) << b)
                    w.own[b] = n_groups;
            }
        n_entries += COUNT(blocks) * (n_placed - begin);
        n_groups++;
    }
}
if (lane == 0)
    w.first_row[n_groups] = n;
if (n_entries > ENTRIES) {
#if !IS_LAST
    leave();
    return;
#else
    // Only where rows had no room in the Jacobian, and what they say is left from another step.
    n = n_groups = 0;
    EACH(b, N_BLOCKS)
        w.own[b] = -1;
#endif
}
bool is_far = false;
EACH(i, NV) {
    ROLLED for (int k = 0; k < inertia_length[i]; k++) {
        const int c = inertia_column[inertia_address[i] + k];
        if (c >> 2 == i >> 2) {
            const float value = M[inertia_address[i] + k];
            w.inertia[i].x[c & 3] = value;
            w.inertia[c].x[i & 3] = value;
        } else {
            is_far = true;
        }
    }
    // The solver begins with a step from nothing to where it starts.
    search[i] = WARMSTART && n > 0 ? qacc_warmstart[i] : qacc_smooth[i];
    qacc[i] = ma[i] = 0.0f;
    smooth[i] = qfrc_smooth[i];
}
EACH(i, PADDED)
    if (i >= NV) {
        w.inertia[i].x[i & 3] = 1.0f;
        search[i] = qacc[i] = ma[i] = smooth[i] = 0.0f;
    }
// Blocks that the inertia couples with others.
const bool has_far = lanes_with(is_far) != 0;
if (has_far) {
    EACH(b, N_BLOCKS)
        ROLLED for (int i = 4 * b; i < 4 * b + 4 && i < NV; i++)
            ROLLED for (int k = 0; k < inertia_length[i]; k++) {
                const int other = inertia_column[inertia_address[i] + k] >> 2;
                if (other != b)
                    w.below[b] |= Set(1) << other;
            }
}
SYNC();

// Blocks that the factor has, and levels: a block's factor needs those of lower levels.
bool is_coupled = false;
EACH(b, N_BLOCKS) {
    is_coupled |= w.below[b] != 0;
    w.above[b] = 0;
    w.first_block[b] = b;
}
int n_blocks = N_BLOCKS, n_levels = 1;
if (lanes_with(is_coupled)) {
    ROLLED for (int j = 0; j < N_BLOCKS; j++) {
        SYNC();
        Set above = 0;
        ROLLED for (int start = 0; start < N_BLOCKS; start += LANES) {
            const int i = start + lane;
            above |= lanes_with(i < N_BLOCKS && HAS(w.below[i < N_BLOCKS ? i : 0], j)) << start;
        }
        if (lane == 0)
            w.above[j] = above;
        if (!above)
            continue;
        EACH(i, N_BLOCKS)
            if (HAS(above, i)) {
                w.below[i] |= above & BELOW(i);
                w.level[i] = w.level[i] > w.level[j] ? w.level[i] : w.level[j] + 1;
            }
    }
    SYNC();
    n_blocks = 0;
    ROLLED for (int b = 0; b < N_BLOCKS; b++) {
        if (lane == 0)
            w.first_block[b] = n_blocks;
        n_blocks += COUNT(w.below[b]) + 1;
        n_levels = w.level[b] >= n_levels ? w.level[b] + 1 : n_levels;
    }
}
if (lane == 0)
    w.first_block[N_BLOCKS] = n_blocks;
#if !IS_LAST
if (n_blocks > BLOCKS) {
    leave();
    return;
}
#endif
// The first of a row's entries.
auto entries = [&](int p, int g) {
    return w.entry + w.first_entry[g] + (p - w.first_row[g]) * COUNT(Set(w.in_group[g]));
};
#if SPARSE
next = place_of(lane);
#endif
EACH(r, n) {
    const int p = w.unsorted.place[r];
    const Set blocks = w.in_group[w.group[p]];
    Four* to = entries(p, w.group[p]);
    w.stiffness[p] = D[r];
    jaref[p] = -reference[r];
#if SPARSE
    const Place now = next;
    next = place_of(r + LANES);
    ROLLED for (int k = 0; k < COUNT(blocks); k++)
        to[k] = Four{};
    if (blocks)
        ROLLED for (int k = 0; k < now.length; k++) {
            const int c = columns_of_rows[now.begin + k];
            to[COUNT(blocks & BELOW(c >> 2))].x[c & 3] += J[now.begin + k];
        }
#else
    EACH_IN(b, blocks)
        *to++ = load(r, b);
#endif
    w.kind[p] = r < n_equalities ? EQUALITY : r < n_equalities + n_frictions ? FRICTION : ONE_SIDED;
    w.state[p] = 255;
}
EACH(b, N_BLOCKS) {
    Four row[4] = {w.inertia[4 * b], w.inertia[4 * b + 1], w.inertia[4 * b + 2], w.inertia[4 * b + 3]};
    for (int c = 0; c < 4; c++) {
        const float pivot = row[c].x[c];
        w.least_pivot[4 * b + c] = has_far ? LEAST_PIVOT * w.inertia[4 * b + c].x[c] : pivot;
        for (int i = 3; i > c; i--)
            for (int k = c + 1; k <= i; k++)
                row[i].x[k] -= QUOTIENT(row[i].x[c] * row[k].x[c], pivot);
    }
}
float trace = 0.0f;
EACH(i, NV)
    trace += w.inertia[i].x[i & 3];
sum(trace);
const float scale = 1.0f / wp::max(TINY, trace);
SYNC();

auto dot = [](const Four& a, const Four& b) {
    return a.x[0] * b.x[0] + a.x[1] * b.x[1] + a.x[2] * b.x[2] + a.x[3] * b.x[3];
};
auto times_inertia = [&](const Four* x, Four* y) {
    EACH(i, PADDED) {
        float total = dot(w.inertia[i], x[i >> 2]);
        if (has_far && i < NV)
            ROLLED for (int c = 0; c < NV; c++) {
                const int id = c >> 2 == i >> 2 ? -1 : c < i ? inertia_id[i * NV + c] : inertia_id[c * NV + i];
                if (id >= 0)
                    total += M[id] * x[c >> 2].x[c & 3];
            }
        y[i >> 2].x[i & 3] = total;
    }
};
auto row_times = [&](int p, const Four* x) {
    const int g = w.group[p];
    const Four* value = entries(p, g);
    float total = 0.0f;
    EACH_IN(b, Set(w.in_group[g]))
        total += dot(*value++, x[b]);
    return total;
};
auto ratio = [](float x, float y) { return y != 0.0f ? QUOTIENT(x, y) : 0.0f; };

// Groups in which a row has a force or is in the Hessian, as bits, the last for all from the 32nd on.
Set is_active = 0;
// States and forces of all rows; returns whether a state has changed.
auto update_rows = [&]() {
    bool has_changed = false;
    Set active = 0;
    EACH(p, n) {
        const float x = jaref[p], d = stiffness[p];
        float f = -d * x;
        int now = QUADRATIC;
        if (w.kind[p] == ONE_SIDED) {
            if (x >= 0.0f)
                f = 0.0f, now = SATISFIED;
        } else if (FRICTIONS && w.kind[p] == FRICTION) {
            const float loss = frictionloss[w.origin[p]], limit = ratio(loss, d);
            if (x <= -limit)
                f = loss, now = LINEARNEG;
            else if (x >= limit)
                f = -loss, now = LINEARPOS;
        }
        has_changed |= now != w.state[p];
        w.state[p] = now;
        force[p] = f;
        w.curvature[p] = now == QUADRATIC ? d : 0.0f;
        if (now != SATISFIED)
            active |= Set(1) << (w.group[p] < 31 ? w.group[p] : 31);
    }
    is_active = in_any(active);
    return lanes_with(has_changed) != 0;
};

float grad_dot, search_dot, decrement;

// The block of the Hessian in row i and column j of blocks.
auto block = [&](int i, int j) -> Block& { return w.hessian[w.first_block[i] + COUNT(w.below[i] & BELOW(j))]; };
auto diagonal = [&](int i) -> Block& { return w.hessian[w.first_block[i + 1] - 1]; };
auto is_group_active = [&](int g) { return HAS(is_active, g < 31 ? g : 31); };

// The gradient, and the Hessian from the inertia and the rows that are active.
auto update_hessian = [&]() {
    if (n_blocks > N_BLOCKS) {
        EACH(q, 4 * n_blocks)
            w.hessian[q >> 2].row[q & 3] = Four{};
        SYNC();
    }
    // Rows of one block, as nearly all are: those of each block by four lanes.
    EACH(i, PADDED) {
        const int b = i >> 2, a = i & 3, g = w.own[b];
        Four h = w.inertia[i];
        float slope = ma[i] - smooth[i];
        if (g >= 0 && is_group_active(g)) {
            const int begin = w.first_row[g], end = w.first_row[g + 1];
            const Four* entry = w.entry + w.first_entry[g];
            ROLLED for (int p = begin; p < end; p++, entry++) {
                const float x = entry->x[a], stiff = w.curvature[p] * x;
                const Four e = *entry;
                slope -= force[p] * x;
                for (int c = 0; c < 4; c++)
                    h.x[c] += stiff * e.x[c];
            }
        }
        diagonal(b).row[a] = h;
        grad[i] = slope;
    }
    if (has_far)
        EACH(i, NV)
            ROLLED for (int k = 0; k < inertia_length[i]; k++) {
                const int c = inertia_column[inertia_address[i] + k];
                if (c >> 2 != i >> 2)
                    block(i >> 2, c >> 2).row[i & 3].x[c & 3] = M[inertia_address[i] + k];
            }
    SYNC();
    ROLLED for (int g = 0; g < n_groups; g++) {
        const Set blocks = w.in_group[g];
        if (!(blocks & (blocks - 1)) || !is_group_active(g))
            continue;
        const int begin = w.first_row[g], end = w.first_row[g + 1];
        const int length = COUNT(blocks), n_products = 8 * length * (length + 1);
        const Four* first = w.entry + w.first_entry[g];
        auto nth = [&](int k) {
            Set rest = blocks;
            ROLLED while (k-- > 0)
                rest &= rest - 1;
            return FIRST(rest);
        };
        EACH(t, n_products + 4 * length) {
            float total = 0.0f;
            const Four* entry = first;
            if (t < n_products) {
                // Pairs u >= v of the group's blocks, and the entries of their product.
                int u = 0, v = t >> 4;
                ROLLED while (v > u)
                    v -= ++u;
                const int a = t >> 2 & 3, c = t & 3;
                ROLLED for (int p = begin; p < end; p++, entry += length)
                    total += w.curvature[p] * entry[u].x[a] * entry[v].x[c];
                block(nth(u), nth(v)).row[a].x[c] += total;
            } else {
                const int u = (t - n_products) >> 2, a = t & 3;
                ROLLED for (int p = begin; p < end; p++, entry += length)
                    total += force[p] * entry[u].x[a];
                grad[4 * nth(u) + a] -= total;
            }
        }
        SYNC();
    }
};

// The direction of search: Cholesky's factor by levels, with the first half of the solution, then the second half.
auto solve = [&]() {
    for (int now = 0; now < n_levels; now++) {
        Set of_level = 0;
        EACH(j, N_BLOCKS) {
            if (w.level[j] != now)
                continue;
            Block& pivot = diagonal(j);
            Block d = pivot;
            Four y = w.grad[j];
            EACH_IN(k, w.below[j]) {
                const Block l = block(j, k);
                const Four z = w.half[k];
                for (int a = 0; a < 4; a++) {
                    for (int c = 0; c <= a; c++)
                        d.row[a].x[c] -= dot(l.row[a], l.row[c]);
                    y.x[a] -= dot(l.row[a], z);
                }
            }
            for (int c = 0; c < 4; c++) {
                const float inverse = INVERSE_ROOT(wp::max(d.row[c].x[c], w.least_pivot[4 * j + c]));
                for (int a = c + 1; a < 4; a++)
                    d.row[a].x[c] *= inverse;
                for (int a = c + 1; a < 4; a++)
                    for (int b = c + 1; b <= a; b++)
                        d.row[a].x[b] -= d.row[a].x[c] * d.row[b].x[c];
                y.x[c] *= inverse;
                for (int a = c + 1; a < 4; a++)
                    y.x[a] -= d.row[a].x[c] * y.x[c];
                w.inverse_pivot[4 * j + c] = inverse;
            }
            pivot = d;
            w.half[j] = y;
            of_level |= Set(1) << j;
        }
        of_level = in_any(of_level);
        SYNC();
        EACH(q, PADDED) {
            const int i = q >> 2, a = q & 3;
            EACH_IN(j, w.below[i] & of_level) {
                Four& at = block(i, j).row[a];
                Four x = at;
                EACH_IN(k, w.below[i] & w.below[j]) {
                    const Four left = block(i, k).row[a];
                    for (int c = 0; c < 4; c++)
                        x.x[c] -= dot(left, block(j, k).row[c]);
                }
                const Block& pivot = diagonal(j);
                for (int c = 0; c < 4; c++) {
                    for (int b = 0; b < c; b++)
                        x.x[c] -= x.x[b] * pivot.row[c].x[b];
                    x.x[c] *= w.inverse_pivot[4 * j + c];
                }
                at = x;
            }
        }
        SYNC();
    }
    for (int now = n_levels - 1; now >= 0; now--) {
        EACH(j, N_BLOCKS) {
            if (w.level[j] != now)
                continue;
            Four x = w.half[j];
            EACH_IN(i, w.above[j]) {
                const Block& l = block(i, j);
                const Four s = w.search[i];
                for (int a = 0; a < 4; a++)
                    for (int c = 0; c < 4; c++)
                        x.x[c] += l.row[a].x[c] * s.x[a];
            }
            const Block& pivot = diagonal(j);
            for (int c = 3; c >= 0; c--) {
                for (int a = c + 1; a < 4; a++)
                    x.x[c] -= pivot.row[a].x[c] * x.x[a];
                x.x[c] *= w.inverse_pivot[4 * j + c];
            }
            w.search[j] = Four{-x.x[0], -x.x[1], -x.x[2], -x.x[3]};
        }
        SYNC();
    }
    grad_dot = search_dot = decrement = 0.0f;
    EACH(i, NV) {
        grad_dot += grad[i] * grad[i];
        search_dot += search[i] * search[i];
        decrement -= grad[i] * search[i];
    }
    sum(grad_dot, search_dot, decrement);
};

int iteration = -1, overflows = 0;
float alpha = 1.0f, improvement = 0.0f, grad_scale = 1.0f, least_alpha = 0.0f;
// An inertia that couples blocks is factorised first, without any row, for its pivots.
bool is_new = true, is_inertia = has_far;
while (true) {
    if (is_new) {
        times_inertia(w.search, w.mv);
        EACH(p, n)
            jv[p] = row_times(p, w.search);
        SYNC();
    }
    if (iteration >= 0) {
        // Line search: costs, slopes and curvatures along the direction, relative to the cost where it begins.
        struct Point {
            float cost, slope, curvature, alpha;
        };
        auto friction_cost = [](float x, float loss, float limit, float d) {
            if (-limit < x && x < limit)
                return 0.5f * d * x * x;
            return x <= -limit ? loss * (-0.5f * limit - x) : loss * (-0.5f * limit + x);
        };
        // Adds what a row has at a step of alpha; equalities are in slope and curvature already.
        auto add_row = [&](int p, float alpha, Point& point) {
            if (w.kind[p] == EQUALITY)
                return;
            const float x0 = jaref[p], v = jv[p], d = stiffness[p], x = x0 + alpha * v, stiff = v * d;
            if (w.kind[p] == ONE_SIDED) {
                // Without branches, which lanes would take one after the other.
                const bool is_pressed = x < 0.0f;
                const float cost0 = 0.5f * d * x0 * x0, began = x0 < 0.0f ? cost0 : 0.0f;
                const float curvature = is_pressed ? v * stiff : 0.0f, change = alpha * curvature;
                const float slope0 = is_pressed ? stiff * x0 : 0.0f, left = is_pressed ? cost0 : 0.0f;
                point.cost += alpha * (slope0 + 0.5f * change) + (left - began);
                point.slope += slope0 + change;
                point.curvature += curvature;
                return;
            }
            if (!FRICTIONS)
                return;
            const float loss = frictionloss[w.origin[p]], limit = ratio(loss, d);
            point.cost += friction_cost(x, loss, limit, d) - friction_cost(x0, loss, limit, d);
            if (-limit < x && x < limit)
                point.slope += stiff * x, point.curvature += v * stiff;
            else
                point.slope += x <= -limit ? -loss * v : loss * v;
        };
        // Where it begins, with the cost of the rows themselves, of which the noise is made.
        float slope = 0.0f, half_curvature = 0.0f, rows_cost = 0.0f;
        Point rows{};
        EACH(i, NV) {
            slope += search[i] * (ma[i] - smooth[i]);
            half_curvature += 0.5f * search[i] * mv[i];
        }
        EACH(p, n) {
            const float x = jaref[p], d = stiffness[p];
            if (w.kind[p] == EQUALITY) {
                const float stiff = jv[p] * d;
                slope += stiff * x;
                half_curvature += 0.5f * jv[p] * stiff;
                continue;
            }
            add_row(p, 0.0f, rows);
            if (FRICTIONS && w.kind[p] == FRICTION) {
                const float loss = frictionloss[w.origin[p]];
                rows_cost += friction_cost(x, loss, ratio(loss, d), d);
            } else if (x < 0.0f) {
                rows_cost += 0.5f * d * x * x;
            }
        }
        sum(slope, half_curvature, rows_cost, rows.slope, rows.curvature);
        const Point origin{0.0f, slope + rows.slope, 2.0f * half_curvature + rows.curvature, 0.0f};
        const float terms = ROOT(2.0f * wp::max(rows_cost, 0.0f) * wp::max(rows.curvature, 0.0f)) + fabsf(slope);
        const float tolerance_of_slope = wp::max(tolerance * ls_tolerance * ROOT(search_dot) / scale, 1e-6f);
        const float accepted = wp::max(tolerance_of_slope, NOISE * terms);
        least_alpha = NOISE * wp::max(1.0f, ratio(terms, origin.curvature));
        // What the rest has, which lanes share, at the points of which each lane knows its rows.
        auto complete = [&](auto&... point) {
            sum(point.cost..., point.slope..., point.curvature...);
            auto add_rest = [&](Point& at) {
                const float change = at.alpha * half_curvature;
                at.cost += at.alpha * change + at.alpha * slope;
                at.slope += 2.0f * change + slope;
                at.curvature += 2.0f * half_curvature;
            };
            (add_rest(point), ...);
        };

        alpha = improvement = 0.0f;
        bool is_found = fabsf(origin.slope) < NOISE * terms;
        auto is_accepted = [&](const Point& point) { return fabsf(point.slope) < accepted && point.cost < 0.0f; };
        if (!is_found) {
            const float newton = -ratio(origin.slope, origin.curvature);
            Point guess{0.0f, 0.0f, 0.0f, newton};
            EACH(p, n)
                add_row(p, newton, guess);
            complete(guess);
            if (is_accepted(guess)) {
                is_found = true;
                alpha = newton, improvement = -guess.cost;
            } else {
                const bool is_less = guess.slope < origin.slope;
                Point lo = is_less ? guess : origin, hi = is_less ? origin : guess;
                for (int step = 0; step < LS_ITERATIONS && !is_found; step++) {
                    Point lo_next{0.0f, 0.0f, 0.0f, lo.alpha - ratio(lo.slope, lo.curvature)};
                    Point hi_next{0.0f, 0.0f, 0.0f, hi.alpha - ratio(hi.slope, hi.curvature)};
                    Point mid{0.0f, 0.0f, 0.0f, 0.5f * (lo.alpha + hi.alpha)};
                    EACH(p, n) {
                        add_row(p, lo_next.alpha, lo_next);
                        add_row(p, hi_next.alpha, hi_next);
                        add_row(p, mid.alpha, mid);
                    }
                    complete(lo_next, hi_next, mid);
                    bool swapped = false;
                    if (is_accepted(lo_next) || is_accepted(hi_next) || is_accepted(mid)) {
                        lo.cost = 1e10f;
                        auto take = [&](const Point& next) {
                            if (is_accepted(next) && next.cost < lo.cost)
                                lo = next;
                        };
                        take(lo_next), take(hi_next), take(mid);
                        hi = lo;
                        is_found = true;
                    } else {
                        // Whether y lies between x and the minimum.
                        auto is_nearer = [](const Point& x, const Point& y) {
                            return (x.slope < y.slope && y.slope < 0.0f) || (x.slope > y.slope && y.slope > 0.0f);
                        };
                        if (is_nearer(lo, lo_next))
                            lo = lo_next, swapped = true;
                        if (is_nearer(lo, mid))
                            lo = mid, swapped = true;
                        if (is_nearer(lo, hi_next))
                            lo = hi_next, swapped = true;
                        if (is_nearer(hi, hi_next) || (hi.slope < 0.0f && hi_next.slope > 0.0f))
                            hi = hi_next, swapped = true;
                        if (is_nearer(hi, mid))
                            hi = mid, swapped = true;
                        if (is_nearer(hi, lo_next))
                            hi = lo_next, swapped = true;
                    }
                    is_found = is_found || !swapped ||
                               (lo.cost < 0.0f && lo.slope < 0.0f && lo.slope > -tolerance_of_slope) ||
                               (hi.cost < 0.0f && hi.slope > 0.0f && hi.slope < tolerance_of_slope);
                    if (lo.cost < 0.0f || hi.cost < 0.0f) {
                        const Point& best = lo.cost < hi.cost ? lo : hi;
                        alpha = best.alpha, improvement = -best.cost;
                    }
                }
                if (!is_found)
                    overflows |= NO_LS_ITERATIONS_LEFT;
            }
        }
    }
    EACH(i, NV) {
        qacc[i] += alpha * search[i];
        ma[i] += alpha * mv[i];
    }
    EACH(p, n)
        jaref[p] += alpha * jv[p];
    iteration++;
    if (n == 0)
        break;
    // Where no state changes, the cost was quadratic: the gradient only becomes shorter, and so does the direction.
    // A step that is mere rounding ends that.
    is_new = update_rows() || fabsf(alpha) < least_alpha;
    SYNC();
    if (is_new) {
        const Set active = is_active;
        do {
            if (is_inertia)
                is_active = 0;
            update_hessian();
            solve();
            if (!is_inertia)
                break;
            EACH(i, PADDED)
                w.least_pivot[i] = 1.0f / (w.inverse_pivot[i] * w.inverse_pivot[i]);
            is_inertia = false, is_active = active;
            SYNC();
        } while (true);
        grad_scale = 1.0f;
    } else {
        const float left = grad_scale - alpha, share = ratio(left, grad_scale);
        grad_dot *= share * share, decrement *= share * share;
        grad_scale = left;
    }
    const float improved = scale * improvement;
    const bool is_done = alpha == 0.0f || (improved > 0.0f && improved < tolerance) ||
                         scale * ROOT(grad_dot) < tolerance || 0.5f * scale * decrement < tolerance;
    if (iteration > 0 && is_done)
        break;
    if (iteration == ITERATIONS) {
        overflows |= ITERATIONS > 0 ? NO_ITERATIONS_LEFT : 0;
        break;
    }
}

EACH(i, NV) {
    qacc_out[i] = qacc[i];
    ma_out[i] = ma[i];
    qfrc_constraint_out[i] = n ? ma[i] - smooth[i] - grad_scale * grad[i] : 0.0f;
}
EACH(p, n) {
    force_out[w.origin[p]] = force[p];
    state_out[w.origin[p]] = w.state[p];
}
if (lane == 0) {
    n_iterations[world] = iteration;
    if (overflows)
        overflow[world] |= overflows;
}
// The next world of this block may only begin when all lanes have read this one.
SYNC();
