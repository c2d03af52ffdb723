#include "firmware_bridge/usb_stream.h"

#include <algorithm>
#include <new>
#include <utility>

namespace celadon {
namespace {

constexpr int kMostFailures = 4;

}  // namespace

UsbStream::UsbStream(libusb_device_handle* handle, std::uint8_t endpoint, bool interrupt, int bytes, int transfers,
                     Sink sink)
    : handle_(handle), endpoint_(endpoint), sink_(std::move(sink)), slots_(static_cast<std::size_t>(transfers)) {
  for (Slot& slot : slots_) {
    slot.stream = this;
    slot.buffer.resize(static_cast<std::size_t>(bytes));
    slot.transfer.reset(libusb_alloc_transfer(0));
    if (!slot.transfer) throw std::bad_alloc();
    const auto fill = interrupt ? libusb_fill_interrupt_transfer : libusb_fill_bulk_transfer;
    fill(slot.transfer.get(), handle, endpoint, slot.buffer.data(), bytes, on_done, &slot, 0);
  }
}

void LIBUSB_CALL UsbStream::on_done(libusb_transfer* transfer) {
  Slot& slot = *static_cast<Slot*>(transfer->user_data);
  UsbStream& stream = *slot.stream;
  slot.under_way = false;
  if (transfer->status == LIBUSB_TRANSFER_STALL) stream.halted_ = true;
  if (transfer->status == LIBUSB_TRANSFER_NO_DEVICE) stream.gone_ = true;
  const bool completed = transfer->status == LIBUSB_TRANSFER_COMPLETED;
  stream.failures_ = completed ? 0 : stream.failures_ + 1;
  if (completed && transfer->actual_length > 0)
    stream.sink_(std::span(slot.buffer).first(static_cast<std::size_t>(transfer->actual_length)));
}

int UsbStream::keep_reading() {
  if (gone_) return LIBUSB_ERROR_NO_DEVICE;
  // Clearing a halt is a control transfer that waits, so it has no place in the callback.
  if (halted_ && failures_ < kMostFailures && idle()) {
    if (const int code = libusb_clear_halt(handle_, endpoint_); code != 0) return code;
    halted_ = false;
  }
  if (halted_ || failures_ >= kMostFailures) return 0;
  for (Slot& slot : slots_) {
    if (slot.under_way) continue;
    if (const int code = libusb_submit_transfer(slot.transfer.get()); code != 0) {
      gone_ = gone_ || code == LIBUSB_ERROR_NO_DEVICE;
      return code;
    }
    slot.under_way = true;
  }
  return 0;
}

void UsbStream::cancel() {
  for (Slot& slot : slots_) {
    if (slot.under_way) (void)libusb_cancel_transfer(slot.transfer.get());
  }
}

bool UsbStream::idle() const {
  return std::none_of(slots_.begin(), slots_.end(), [](const Slot& slot) { return slot.under_way; });
}

}  // namespace celadon
