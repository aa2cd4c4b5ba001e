#pragma once
// What a sample of no declared input holds: of answers to gets, and of subscriptions by hand.

#include "common/messages/keys.hpp"
#include "common/messages/verify.hpp"
#include "common/zenoh/aligned.hpp"

namespace zloam::runtime {

/// The message of a sample with what keeps its bytes; false: it is larger than any of its key, or
/// not in order.
template <class T>
class Read {
 public:
  Read(Key key, const zenoh::Sample& sample) {
    if (!fits(key, sample.payload.size())) return;
    bytes_ = zenoh::view_aligned(sample.payload);
    ok_ = verify<T>(bytes_.data(), sample.encoding).ok();
  }
  explicit operator bool() const { return ok_; }
  const T& operator*() const { return message_of<T>(bytes_.data()); }
  const T* operator->() const { return &message_of<T>(bytes_.data()); }

 private:
  zenoh::AlignedBytes bytes_;
  bool ok_ = false;
};

}  // namespace zloam::runtime
