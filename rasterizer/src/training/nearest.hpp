// The points nearest to some of a set of points in space, by a k-d tree (Bentley 1975) whose leaves are
// compared with at once, a point in each lane.
#pragma once

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "simd/vec.hpp"

namespace splat {

class KdTree {
public:
    // points: the first three of each `stride` values; count >= 1.
    KdTree(const scalar* points, uint32_t count, int stride) {
        std::vector<Point> all(count);
        Point low{{kLargest, kLargest, kLargest}, 0}, high{{-kLargest, -kLargest, -kLargest}, 0};
        for (uint32_t i = 0; i < count; ++i) {
            all[i].id = i;
            for (int k = 0; k < 3; ++k) {
                const scalar x = points[static_cast<size_t>(stride) * i + k];
                all[i].x[k] =
                    x == x ? std::clamp(x, -kLargest, kLargest) : kLargest;  // NaN has no place in an order
                low.x[k] = std::min(low.x[k], all[i].x[k]), high.x[k] = std::max(high.x[k], all[i].x[k]);
            }
        }
        nodes_.reserve(count / 4), leaves_.reserve(count / 8 + 1);
        split(all.data(), all.data() + count, low, high);
    }

    // The k points nearest to `at`, nearest first: their numbers and squared distances.
    void nearest(const scalar* at, int k, int32_t* id, scalar* square) const {
        std::fill_n(square, k, std::numeric_limits<scalar>::infinity());
        std::fill_n(id, k, 0);
        visit(0, at, k, id, square);
    }

private:
    static constexpr scalar kLargest = std::numeric_limits<scalar>::max();
    struct Point {
        scalar x[3];
        uint32_t id;
    };
    struct Node {
        int axis;         // -1: a leaf
        scalar border;    // the first half lies below it along the axis, the second above
        uint32_t second;  // the node of the second half, that of the first is the next one; of a leaf: which
    };
    struct Leaf {
        scalar x[3][kLanes];  // infinity beyond the last point
        uint32_t id[kLanes];
    };

    // low, high: the corners of a box around the points.
    void split(Point* first, Point* last, const Point& low, const Point& high) {
        const size_t node = nodes_.size();
        nodes_.push_back({-1, 0, static_cast<uint32_t>(leaves_.size())});
        if (last - first <= kLanes) return add_leaf(first, last);
        int axis = 0;
        for (int k = 1; k < 3; ++k)
            if (high.x[k] - low.x[k] > high.x[axis] - low.x[axis]) axis = k;
        // The first half fills whole leaves.
        Point* middle = first + ((last - first + 1) / 2 + kLanes - 1) / kLanes * kLanes;
        std::nth_element(first, middle, last,
                         [axis](const Point& a, const Point& b) { return a.x[axis] < b.x[axis]; });
        const scalar border = middle->x[axis];
        nodes_[node].axis = axis, nodes_[node].border = border;
        Point below = high, above = low;
        below.x[axis] = above.x[axis] = border;
        split(first, middle, low, below);
        nodes_[node].second = static_cast<uint32_t>(nodes_.size());
        split(middle, last, above, high);
    }

    void add_leaf(const Point* first, const Point* last) {
        Leaf leaf;
        for (auto& column : leaf.x) std::fill_n(column, kLanes, std::numeric_limits<scalar>::infinity());
        std::fill_n(leaf.id, kLanes, 0);
        for (int l = 0; first + l < last; ++l) {
            for (int k = 0; k < 3; ++k) leaf.x[k][l] = first[l].x[k];
            leaf.id[l] = first[l].id;
        }
        leaves_.push_back(leaf);
    }

    void visit(uint32_t node, const scalar* at, int k, int32_t* id, scalar* square) const {
        const Node& n = nodes_[node];
        if (n.axis < 0) return compare(leaves_[n.second], at, k, id, square);
        const scalar beyond = at[n.axis] - n.border;
        visit(beyond < 0 ? node + 1 : n.second, at, k, id, square);
        if (beyond * beyond < square[k - 1]) visit(beyond < 0 ? n.second : node + 1, at, k, id, square);
    }

    static void compare(const Leaf& leaf, const scalar* at, int k, int32_t* id, scalar* square) {
        Float sum(0.f);
        for (int i = 0; i < 3; ++i) {
            const Float d = Float::load(leaf.x[i]) - Float(at[i]);
            sum += d * d;
        }
        alignas(64) scalar found[kLanes];
        sum.store(found);
        for (unsigned left = bits(sum < Float(square[k - 1])); left; left &= left - 1) {
            const int l = __builtin_ctz(left);
            int place = k - 1;
            if (!(found[l] < square[place])) continue;
            for (; place > 0 && found[l] < square[place - 1]; --place)
                square[place] = square[place - 1], id[place] = id[place - 1];
            square[place] = found[l], id[place] = static_cast<int32_t>(leaf.id[l]);
        }
    }

    std::vector<Node> nodes_;
    std::vector<Leaf> leaves_;
};

// For each of `rows` the k <= count points nearest to it, itself among them, nearest first: numbers and
// distances [queries, k].
inline void nearest_points(const scalar* points, uint32_t count, int stride, const int64_t* rows,
                           int64_t queries, int k, int32_t* index, scalar* distance, int threads) {
    const KdTree tree(points, count, stride);
#pragma omp parallel for schedule(static) num_threads(threads)
    for (int64_t q = 0; q < queries; ++q) {
        scalar* square = distance + q * k;
        tree.nearest(points + stride * rows[q], k, index + q * k, square);
        for (int i = 0; i < k; ++i) square[i] = std::sqrt(square[i]);
    }
}

}  // namespace splat
