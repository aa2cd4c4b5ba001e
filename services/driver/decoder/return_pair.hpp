#pragma once
// Types of returns: of a single one, and of the two of a firing whose packet contains the last one
// and another one, the strongest or the second strongest (Velodyne and Hesai).

#include "driver/decoder/packet_decoder.hpp"

namespace zloam::driver {

/// Of packets with one return.
inline ReturnType single_type(ReturnMode mode) {
  return mode == ReturnMode::kLast ? ReturnType::kLast : ReturnType::kStrongest;
}

struct PairChoice {
  bool last;
  bool strongest;
  ReturnType last_type;
  ReturnType strongest_type;
};

/// last and strongest: that return exists; same: both have equal distance and so are one return
/// (VLP-16 manual p. 57).
inline PairChoice choose(bool last, bool strongest, bool same, DualReturns policy) {
  const bool both = policy == DualReturns::kBoth || same;
  PairChoice choice{last, strongest && !same, both ? ReturnType::kBoth : ReturnType::kLast,
                    both ? ReturnType::kBoth : ReturnType::kStrongest};
  // Where one return stands for the firing, the stages that follow must not refuse it for its type:
  // by default they take the strongest.
  if (policy == DualReturns::kStrongest) {
    if (choice.strongest) choice.last = false;
    choice.last_type = ReturnType::kBoth;
  }
  if (policy == DualReturns::kLast) {
    if (choice.last) choice.strongest = false;
    choice.last_type = choice.strongest_type = ReturnType::kBoth;
  }
  return choice;
}

}  // namespace zloam::driver
