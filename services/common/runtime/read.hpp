#pragma once
// Reads samples that belong to no declared input: answers to gets, and manual subscriptions.

#include "common/messages/keys.hpp"
#include "common/messages/verify.hpp"
#include "common/zenoh/aligned.hpp"

namespace zloam::runtime {

/// The message of a sample, with its bytes; false: it is larger than any message of its key, or
/// invalid.
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
