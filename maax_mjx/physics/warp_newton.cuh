// The body of one thread of `warp_newton`: Newton's method on the constraint forces of one world, by the LANES threads of
// a block. It follows MJX-Warp's solver step by step: the same costs, line search and criteria to stop.
//
// All of a world's data live in shared memory. Sets of degrees of freedom are 64-bit masks: the columns of a row of the
// Jacobian, of the inertia, and of the Hessian's factor, so that what is zero costs nothing.
//
// The caller defines NV, ROWS, ENTRIES, SPARSE, STRIDE, WARMSTART, ITERATIONS, LS_ITERATIONS, RESIDENT, the bits
// NO_ITERATIONS_LEFT and NO_LS_ITERATIONS_LEFT, and the states SATISFIED, QUADRATIC, LINEARNEG and LINEARPOS.
// RESIDENT: rows are copied into shared memory; a world with more than ROWS rows or ENTRIES entries is left, with -1 as
// its iterations. Not RESIDENT: takes these worlds, and reads rows where they are.

typedef unsigned long long Set;

#if defined(__CUDA_ARCH__)
#define LANES 32
#define SHARED __shared__
#define SYNC() __syncwarp()
#define COUNT(set) __popcll(set)
#define FIRST(set) (__ffsll(set) - 1)
#else
#define LANES 1
#define SHARED
#define SYNC()
#define COUNT(set) __builtin_popcountll(set)
#define FIRST(set) __builtin_ctzll(set)
#endif
#define BELOW(i) ((Set(1) << (i)) - 1)
#define ALL (~Set(0) >> (64 - NV))
#define EACH_FROM(i, begin, n) for (int i = (begin) + lane; i < (n); i += LANES)
#define EACH(i, n) EACH_FROM(i, 0, n)
#define EACH_IN(c, set) for (Set rest_##c = (set), c = 0; rest_##c && (c = FIRST(rest_##c), true); rest_##c &= rest_##c - 1)
#define LOWER(i, j) hessian[(i) * ((i) + 1) / 2 + (j)]
#define INERTIA_ID(i, j) inertia_id[(i) > (j) ? (i) * NV + (j) : (j) * NV + (i)]

const float TINY = 1e-15f;
// Rounding of sums, in units of their terms; MJX-Warp allows for so much, too.
const float NOISE = 8.0f * 1.1920929e-07f;
// A pivot is at least so much of the inertia: rows only add to it, what is less has been lost to rounding.
const float LEAST_PIVOT = 1e-4f;

// One row more than the Hessian has: the gradient, whose factor is the first half of the solution.
SHARED float hessian[(NV + 1) * (NV + 2) / 2];
SHARED float inverse_pivot[NV], diagonal[NV], qacc[NV], ma[NV], smooth[NV], grad[NV], search[NV], mv[NV];
SHARED Set in_inertia[NV], in_factor[NV + 1], in_row[ROWS];
SHARED float jaref[ROWS], jv[ROWS], stiffness[ROWS], force[ROWS];
SHARED unsigned char state[ROWS];
SHARED short first_row[ROWS + 1];
SHARED int column[NV];
#if RESIDENT
SHARED short address[ROWS];
SHARED float entry[ENTRIES];
#define ENTRIES_OF(r) (entry + address[r])
#elif SPARSE
#define ENTRIES_OF(r) (J + row_address[r])
#else
#define ENTRIES_OF(r) (J + (r) * STRIDE)
#endif

auto sum = [](float x) {
#if defined(__CUDA_ARCH__)
    for (int step = 16; step; step /= 2)
        x += __shfl_xor_sync(0xffffffffu, x, step);
#endif
    return x;
};
// The sum of the lanes before this one; `total` is that of all.
auto sum_before = [&](int x, int& total) {
    int before = 0;
    total = x;
#if defined(__CUDA_ARCH__)
    int through = x;
    for (int step = 1; step < 32; step *= 2) {
        int other = __shfl_up_sync(0xffffffffu, through, step);
        if (lane >= step)
            through += other;
    }
    before = through - x;
    total = __shfl_sync(0xffffffffu, through, 31);
#endif
    return before;
};
auto of_first_lane = [](float x) {
#if defined(__CUDA_ARCH__)
    x = __shfl_sync(0xffffffffu, x, 0);
#endif
    return x;
};

const int n = n_rows < CAPACITY ? n_rows : CAPACITY;
#if RESIDENT
if (n > ROWS) {
    if (lane == 0)
        n_iterations[world] = -1;
    return;
}
#else
if (n_iterations[world] >= 0)
    return;
#endif

// Rows: which columns each has, and their values.
int n_entries = 0;
for (int start = 0; start < n; start += LANES) {
    const int r = start + lane;
    Set columns = 0;
    if (r < n) {
#if SPARSE
        int* cols = columns_of_rows + row_address[r];
        const int length = row_length[r];
        for (int k = 0; k < length; k++)
            columns |= Set(1) << cols[k];
#if !RESIDENT
        // Entries in the order of their columns, as those of a set are.
        float* values = J + row_address[r];
        for (int k = 1; k < length; k++)
            for (int at = k; at > 0 && cols[at] < cols[at - 1]; at--) {
                const int c = cols[at];
                const float value = values[at];
                cols[at] = cols[at - 1], values[at] = values[at - 1];
                cols[at - 1] = c, values[at - 1] = value;
            }
#endif
#elif RESIDENT
        for (int c = 0; c < NV; c++)
            if (J[r * STRIDE + c] != 0.0f)
                columns |= Set(1) << c;
#else
        columns = ALL;
#endif
        in_row[r] = columns;
    }
#if RESIDENT
    int total;
    const int before = sum_before(COUNT(columns), total);
    if (r < n)
        address[r] = n_entries + before;
    n_entries += total;
#endif
}
#if RESIDENT
if (n_entries > ENTRIES) {
    if (lane == 0)
        n_iterations[world] = -1;
    return;
}
EACH(r, n) {
#if SPARSE
    for (int k = 0; k < row_length[r]; k++) {
        const int c = columns_of_rows[row_address[r] + k];
        entry[address[r] + COUNT(in_row[r] & BELOW(c))] = J[row_address[r] + k];
    }
#else
    float* to = entry + address[r];
    EACH_IN(c, in_row[r])
        *to++ = J[r * STRIDE + c];
#endif
}
#endif
SYNC();

// Runs of rows with the same columns, as those of a contact have: each begins at `first_row` and ends at the next.
int n_runs = 0;
for (int start = 0; start < n; start += LANES) {
    const int r = start + lane;
    const int is_first = r < n && (r == 0 || in_row[r] != in_row[r - 1]);
    int total;
    const int before = sum_before(is_first, total);
    if (is_first)
        first_row[n_runs + before] = r;
    n_runs += total;
}
if (lane == 0)
    first_row[n_runs] = n;

float trace = 0.0f;
EACH(i, NV) {
    Set columns = 0;
    for (int c = 0; c < NV; c++)
        if (INERTIA_ID(i, c) >= 0)
            columns |= Set(1) << c;
    in_inertia[i] = columns;
    diagonal[i] = M[INERTIA_ID(i, i)];
    trace += diagonal[i];
    qacc[i] = WARMSTART && n > 0 ? qacc_warmstart[i] : qacc_smooth[i];
    smooth[i] = qfrc_smooth[i];
}
const float scale = 1.0f / wp::max(TINY, sum(trace));
SYNC();

auto times_inertia = [&](const float* x, float* y) {
    EACH(i, NV) {
        float total = 0.0f;
        EACH_IN(c, in_inertia[i])
            total += M[INERTIA_ID(i, (int)c)] * x[c];
        y[i] = total;
    }
};
auto row_times = [&](int r, const float* x) {
    const float* value = ENTRIES_OF(r);
    float total = 0.0f;
    EACH_IN(c, in_row[r])
        total += *value++ * x[c];
    return total;
};

// States and forces of all rows; returns how many states changed.
auto update_rows = [&]() {
    float n_changed = 0.0f;
    EACH(r, n) {
        const float x = jaref[r], d = stiffness[r];
        float f = -d * x;
        int now = QUADRATIC;
        if (r >= n_equalities + n_frictions) {
            if (x >= 0.0f)
                f = 0.0f, now = SATISFIED;
        } else if (r >= n_equalities) {
            const float loss = frictionloss[r], limit = d != 0.0f ? loss / d : 0.0f;
            if (x <= -limit)
                f = loss, now = LINEARNEG;
            else if (x >= limit)
                f = -loss, now = LINEARPOS;
        }
        n_changed += now != state[r];
        state[r] = now;
        force[r] = f;
    }
    return sum(n_changed);
};

float grad_dot, search_dot, decrement;

// The gradient, the Hessian from the inertia and the rows that are active, and the direction of search from them.
auto update_search = [&]() {
    EACH(i, NV) {
        for (int j = 0; j < i; j++)
            LOWER(i, j) = 0.0f;
        EACH_IN(c, in_inertia[i] & BELOW(i))
            LOWER(i, c) = M[INERTIA_ID(i, (int)c)];
        LOWER(i, i) = diagonal[i];
        in_factor[i] = in_inertia[i] & BELOW(i);
        grad[i] = ma[i] - smooth[i];
    }
    SYNC();
    for (int run = 0; run < n_runs; run++) {
        const int begin = first_row[run], end = first_row[run + 1];
        bool is_active = false;
        for (int r = begin; r < end; r++)
            is_active |= force[r] != 0.0f || state[r] == QUADRATIC;
        if (!is_active)
            continue;
        const Set columns = in_row[begin];
        EACH(c, NV)
            if (columns >> c & 1) {
                column[COUNT(columns & BELOW(c))] = c;
                in_factor[c] |= columns & BELOW(c);
            }
        SYNC();
        const int length = COUNT(columns), n_pairs = length * (length + 1) / 2;
        EACH(p, n_pairs + length) {
            float total = 0.0f;
            if (p < n_pairs) {
                // The p-th pair a >= b, counted along the rows of a triangle.
                const int a = (int)((sqrtf(8.0f * p + 1.0f) - 1.0f) * 0.5f), b = p - a * (a + 1) / 2;
                for (int r = begin; r < end; r++)
                    if (state[r] == QUADRATIC)
                        total += stiffness[r] * ENTRIES_OF(r)[a] * ENTRIES_OF(r)[b];
                LOWER(column[a], column[b]) += total;
            } else {
                const int a = p - n_pairs;
                for (int r = begin; r < end; r++)
                    total += force[r] * ENTRIES_OF(r)[a];
                grad[column[a]] -= total;
            }
        }
        SYNC();
    }
    EACH(i, NV)
        LOWER(NV, i) = grad[i];
    if (lane == 0)
        in_factor[NV] = ALL;
    SYNC();
    // Cholesky's factor, column by column, each lane a row.
    for (int j = 0; j < NV; j++) {
        const Set in_j = in_factor[j];
        float inverse = 0.0f;
        for (int start = j; start <= NV; start += LANES) {
            const int i = start + lane;
            float x = 0.0f;
            bool is_in = false;
            if (i <= NV) {
                const Set common = in_factor[i] & in_j;
                is_in = i == j || common || (in_factor[i] >> j & 1);
                if (is_in) {
                    x = LOWER(i, j);
                    EACH_IN(k, common)
                        x -= LOWER(i, k) * LOWER(j, k);
                }
            }
            if (start == j)
                inverse = 1.0f / sqrtf(wp::max(of_first_lane(x), LEAST_PIVOT * diagonal[j]));
            if (is_in && i > j) {
                LOWER(i, j) = x * inverse;
                in_factor[i] |= Set(1) << j;
            }
        }
        if (lane == 0)
            inverse_pivot[j] = inverse;
        SYNC();
    }
    for (int j = NV - 1; j >= 0; j--) {
        const float x = LOWER(NV, j) * inverse_pivot[j];
        EACH(k, j)
            if (in_factor[j] >> k & 1)
                LOWER(NV, k) -= LOWER(j, k) * x;
        if (lane == 0)
            search[j] = -x;
        SYNC();
    }
    float of_grad = 0.0f, of_search = 0.0f, of_both = 0.0f;
    EACH(i, NV) {
        of_grad += grad[i] * grad[i];
        of_search += search[i] * search[i];
        of_both -= grad[i] * search[i];
    }
    grad_dot = sum(of_grad), search_dot = sum(of_search), decrement = sum(of_both);
};

times_inertia(qacc, ma);
EACH(r, n) {
    stiffness[r] = efc_D[r];
    jaref[r] = row_times(r, qacc) - efc_aref[r];
    state[r] = 255;
}
SYNC();
update_rows();
SYNC();
int iteration = 0, overflows = 0;
float grad_scale = 1.0f;

if (n == 0) {
    EACH(i, NV)
        grad[i] = ma[i] - smooth[i];
} else {
    update_search();
    bool is_new = true, is_done = false;
    while (iteration < ITERATIONS && !is_done) {
        if (is_new) {
            times_inertia(search, mv);
            EACH(r, n)
                jv[r] = row_times(r, search);
            SYNC();
        }

        // Line search: costs, slopes and curvatures along the direction, relative to the cost where it begins.
        struct Point {
            float cost, slope, curvature, alpha;
        };
        float slope = 0.0f, half_curvature = 0.0f;
        EACH(i, NV) {
            slope += search[i] * (ma[i] - smooth[i]);
            half_curvature += 0.5f * search[i] * mv[i];
        }
        EACH(r, n_equalities) {
            const float stiff = jv[r] * stiffness[r];
            slope += stiff * jaref[r];
            half_curvature += 0.5f * jv[r] * stiff;
        }
        slope = sum(slope), half_curvature = sum(half_curvature);

        auto friction_cost = [](float x, float loss, float limit, float d) {
            if (-limit < x && x < limit)
                return 0.5f * d * x * x;
            return x <= -limit ? loss * (-0.5f * limit - x) : loss * (-0.5f * limit + x);
        };
        // Adds what a row, which is no equality, has at a step of alpha.
        auto add_row = [&](int r, float alpha, Point& point) {
            const float x0 = jaref[r], v = jv[r], d = stiffness[r], x = x0 + alpha * v, stiff = v * d;
            if (r >= n_equalities + n_frictions) {
                const float cost0 = 0.5f * d * x0 * x0, began = x0 < 0.0f ? cost0 : 0.0f;
                if (x < 0.0f) {
                    const float curvature = v * stiff, change = alpha * curvature;
                    point.cost += alpha * (stiff * x0 + 0.5f * change) + (cost0 - began);
                    point.slope += stiff * x0 + change;
                    point.curvature += curvature;
                } else {
                    point.cost -= began;
                }
                return;
            }
            const float loss = frictionloss[r], limit = d != 0.0f ? loss / d : 0.0f;
            point.cost += friction_cost(x, loss, limit, d) - friction_cost(x0, loss, limit, d);
            if (-limit < x && x < limit)
                point.slope += stiff * x, point.curvature += v * stiff;
            else
                point.slope += x <= -limit ? -loss * v : loss * v;
        };
        auto at = [&](float alpha) {
            const float change = alpha * half_curvature;
            return Point{alpha * change + alpha * slope, 2.0f * change + slope, 2.0f * half_curvature, alpha};
        };
        auto plus = [&](const Point& point, const Point& rows) {
            return Point{point.cost + sum(rows.cost), point.slope + sum(rows.slope),
                         point.curvature + sum(rows.curvature), point.alpha};
        };
        auto ratio = [](float x, float y) { return y != 0.0f ? x / y : 0.0f; };

        // Where it begins, with the cost of the rows themselves, of which the noise is made.
        Point rows{};
        EACH_FROM(r, n_equalities, n) {
            const float x = jaref[r], v = jv[r], d = stiffness[r];
            if (r >= n_equalities + n_frictions) {
                if (x < 0.0f)
                    rows.cost += 0.5f * d * x * x, rows.slope += v * d * x, rows.curvature += v * v * d;
            } else {
                const float loss = frictionloss[r], limit = d != 0.0f ? loss / d : 0.0f;
                rows.cost += friction_cost(x, loss, limit, d);
                if (-limit < x && x < limit)
                    rows.slope += v * d * x, rows.curvature += v * v * d;
                else
                    rows.slope += x <= -limit ? -loss * v : loss * v;
            }
        }
        const float rows_cost = sum(rows.cost), rows_curvature = sum(rows.curvature);
        const Point origin{0.0f, slope + sum(rows.slope), 2.0f * half_curvature + rows_curvature, 0.0f};
        const float terms = sqrtf(2.0f * wp::max(rows_cost, 0.0f) * wp::max(rows_curvature, 0.0f)) + fabsf(slope);
        const float tolerance_of_slope = wp::max(tolerance * ls_tolerance * sqrtf(search_dot) / scale, 1e-6f);
        const float accepted = wp::max(tolerance_of_slope, NOISE * terms);
        const float least_alpha = NOISE * wp::max(1.0f, ratio(terms, origin.curvature));

        float alpha = 0.0f, improvement = 0.0f;
        bool is_found = fabsf(origin.slope) < NOISE * terms;
        auto is_accepted = [&](const Point& point) { return fabsf(point.slope) < accepted && point.cost < 0.0f; };
        if (!is_found) {
            const float newton = -ratio(origin.slope, origin.curvature);
            rows = Point{};
            EACH_FROM(r, n_equalities, n)
                add_row(r, newton, rows);
            const Point guess = plus(at(newton), rows);
            if (is_accepted(guess)) {
                is_found = true;
                alpha = newton, improvement = -guess.cost;
            }
            if (!is_found) {
                const bool is_less = guess.slope < origin.slope;
                Point lo = is_less ? guess : origin, hi = is_less ? origin : guess;
                for (int k = 0; k < LS_ITERATIONS && !is_found; k++) {
                    const float alphas[3] = {lo.alpha - ratio(lo.slope, lo.curvature),
                                             hi.alpha - ratio(hi.slope, hi.curvature), 0.5f * (lo.alpha + hi.alpha)};
                    Point next[3] = {};
                    EACH_FROM(r, n_equalities, n)
                        for (int p = 0; p < 3; p++)
                            add_row(r, alphas[p], next[p]);
                    for (int p = 0; p < 3; p++)
                        next[p] = plus(at(alphas[p]), next[p]);
                    const Point &lo_next = next[0], &hi_next = next[1], &mid = next[2];
                    bool swapped = false;
                    if (is_accepted(lo_next) || is_accepted(hi_next) || is_accepted(mid)) {
                        lo.cost = 1e10f;
                        for (int p = 0; p < 3; p++)
                            if (is_accepted(next[p]) && next[p].cost < lo.cost)
                                lo = next[p];
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

        EACH(i, NV) {
            qacc[i] += alpha * search[i];
            ma[i] += alpha * mv[i];
        }
        EACH(r, n)
            jaref[r] += alpha * jv[r];
        SYNC();
        // Where no state changes, the cost was quadratic: the gradient only becomes shorter, and so does the direction.
        // A step that is mere rounding ends that.
        is_new = update_rows() > 0.0f || fabsf(alpha) < least_alpha;
        SYNC();
        if (is_new) {
            update_search();
            grad_scale = 1.0f;
        } else {
            const float left = grad_scale - alpha, share = ratio(left, grad_scale);
            grad_dot *= share * share, decrement *= share * share;
            grad_scale = left;
        }
        iteration++;
        const float improved = scale * improvement;
        is_done = alpha == 0.0f || (improved > 0.0f && improved < tolerance) || scale * sqrtf(grad_dot) < tolerance ||
                  0.5f * scale * decrement < tolerance;
    }
    if (!is_done && iteration == ITERATIONS)
        overflows |= NO_ITERATIONS_LEFT;
}

EACH(i, NV) {
    qacc_out[i] = qacc[i];
    ma_out[i] = ma[i];
    qfrc_constraint_out[i] = n ? ma[i] - smooth[i] - grad_scale * grad[i] : 0.0f;
}
EACH(r, n) {
    force_out[r] = force[r];
    state_out[r] = state[r];
}
if (lane == 0) {
    n_iterations[world] = iteration;
    if (overflows)
        overflow[world] |= overflows;
}
